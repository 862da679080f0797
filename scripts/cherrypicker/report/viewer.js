// Orbit view of a point cloud and its skeleton, in plain WebGL with a 2D canvas to fall back on.
"use strict";
(function () {
  const box = document.getElementById("viewer");
  if (!box) return;
  const meta = JSON.parse(document.getElementById("viewer-meta").textContent);
  const bytes = (id) => {
    const text = atob(document.getElementById(id).textContent.trim());
    const out = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
    return out.buffer;
  };
  const cloud = {
    position: new Uint16Array(bytes("viewer-positions")),
    rgb: new Uint8Array(bytes("viewer-colors")),
    label: new Uint8Array(bytes("viewer-labels")),
  };
  const edges = new Float32Array(bytes("viewer-edges")); // x y z radius, twice, then order
  const canvas = box.querySelector("canvas");
  const status = box.querySelector(".viewer-status");
  const N = cloud.label.length, STRIDE = 9, E = edges.length / STRIDE;
  const state = {
    mode: meta.has_color ? "rgb" : "class", cloud: true, skeleton: true, thick: false,
    hidden: new Set(), size: 2,
    azimuth: 0.6, elevation: 0.25, distance: 1, target: meta.center.slice(),
  };
  const reach = meta.reach;
  function home() {
    state.azimuth = 0.6; state.elevation = 0.2; state.distance = 2.6 * reach;
    state.target = meta.center.slice();
  }
  home();

  // ---- camera ---------------------------------------------------------------------------------
  function axes() {
    const ca = Math.cos(state.azimuth), sa = Math.sin(state.azimuth);
    const ce = Math.cos(state.elevation), se = Math.sin(state.elevation);
    return {
      back: [ce * sa, -ce * ca, se], right: [ca, sa, 0], up: [-se * sa, se * ca, ce],
    };
  }
  function matrix(aspect) {
    const { back, right, up } = axes();
    const f = 1 / Math.tan(0.35), d = state.distance, near = 0.02 * d, far = d + 40 * reach;
    const eye = state.target.map((t, i) => t + d * back[i]);
    const dot = (a) => a[0] * eye[0] + a[1] * eye[1] + a[2] * eye[2];
    const v = [right, up, back].map((a) => [a[0], a[1], a[2], -dot(a)]);
    const A = -(far + near) / (far - near), B = (-2 * far * near) / (far - near);
    const m = [];
    for (let c = 0; c < 4; c++) {
      m.push((f / aspect) * v[0][c], f * v[1][c], A * v[2][c] + (c === 3 ? B : 0), -v[2][c]);
    }
    return new Float32Array(m); // column major
  }

  // ---- input ----------------------------------------------------------------------------------
  let waiting = false;
  function redraw() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  }
  const pointers = new Map();
  function pan(dx, dy) {
    const { right, up } = axes(), k = (0.73 * state.distance) / canvas.clientHeight;
    for (let i = 0; i < 3; i++) state.target[i] += k * (-dx * right[i] + dy * up[i]);
  }
  canvas.addEventListener("pointerdown", (e) => {
    canvas.setPointerCapture(e.pointerId);
    pointers.set(e.pointerId, [e.clientX, e.clientY]);
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (e) => pointers.delete(e.pointerId));
  }
  canvas.addEventListener("pointermove", (e) => {
    const last = pointers.get(e.pointerId);
    if (!last) return;
    const dx = e.clientX - last[0], dy = e.clientY - last[1];
    if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== e.pointerId)[1];
      const before = Math.hypot(last[0] - other[0], last[1] - other[1]);
      const after = Math.hypot(e.clientX - other[0], e.clientY - other[1]);
      state.distance *= before / Math.max(after, 1);
      pan(dx / 2, dy / 2);
    } else if (e.shiftKey || e.buttons & 6) {
      pan(dx, dy);
    } else {
      state.azimuth -= dx * 0.008;
      state.elevation = Math.min(1.55, Math.max(-1.55, state.elevation + dy * 0.008));
    }
    pointers.set(e.pointerId, [e.clientX, e.clientY]);
    redraw();
  });
  canvas.addEventListener("wheel", (e) => {
    e.preventDefault();
    const step = Math.exp(Math.sign(e.deltaY) * Math.min(Math.abs(e.deltaY), 120) * 0.0015);
    state.distance = Math.min(40 * reach, Math.max(0.02 * reach, state.distance * step));
    redraw();
  }, { passive: false });
  canvas.addEventListener("dblclick", () => { home(); redraw(); });
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("keydown", (e) => {
    const turn = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    if (turn[e.key]) {
      state.azimuth += turn[e.key][0];
      state.elevation = Math.min(1.55, Math.max(-1.55, state.elevation + turn[e.key][1]));
    } else if (e.key === "+" || e.key === "=") state.distance *= 0.87;
    else if (e.key === "-") state.distance *= 1.15;
    else return;
    e.preventDefault(); redraw();
  });
  box.addEventListener("input", (e) => {
    const t = e.target;
    if (t.name === "mode") state.mode = t.value;
    else if (t.name === "size") state.size = Number(t.value);
    else if (t.name === "class") t.checked ? state.hidden.delete(+t.value) : state.hidden.add(+t.value);
    else if (t.name in state) state[t.name] = t.checked;
    else return;
    redraw();
  });
  const reset = box.querySelector("button[name=home]");
  reset.addEventListener("click", () => { home(); redraw(); });

  // ---- colours --------------------------------------------------------------------------------
  const slot = (label) => meta.labels.indexOf(label);
  const slots = Uint8Array.from(cloud.label, (label) => Math.max(slot(label), 0));
  const orderColor = (order) => meta.order_colors[order % meta.order_colors.length];

  // ---- WebGL ----------------------------------------------------------------------------------
  const POINTS_VS = `
    attribute vec3 position; attribute vec3 rgb; attribute float slot;
    uniform mat4 view; uniform vec3 low, span; uniform vec3 palette[10]; uniform float shown[10];
    uniform float byClass, size; varying vec3 color;
    void main() {
      int k = int(slot + 0.5); vec3 own = rgb; float visible = 1.0;
      for (int i = 0; i < 10; i++) if (i == k) {
        visible = shown[i]; own = mix(rgb, palette[i], byClass);
      }
      gl_Position = visible > 0.5 ? view * vec4(low + position * span, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
      gl_PointSize = size; color = own;
    }`;
  const EDGES_VS = `
    attribute vec3 a, b; attribute vec4 how; attribute vec3 rgb;
    uniform mat4 view; uniform vec2 pixels; uniform float thick; varying vec3 color;
    void main() {
      vec4 p = view * vec4(a, 1.0), q = view * vec4(b, 1.0);
      vec4 me = how.x < 0.5 ? p : q;
      vec2 along = (q.xy / q.w - p.xy / p.w) * pixels;
      float len = length(along);
      vec2 normal = len > 1e-4 ? vec2(-along.y, along.x) / len : vec2(1.0, 0.0);
      float own = thick > 0.5 ? how.z * pixels.y * 2.7395 / max(me.w, 1e-6) : 1.3;
      me.xy += normal * how.y * max(own, 1.1) / pixels * me.w;
      me.z -= 0.0004 * me.w;
      gl_Position = me; color = rgb;
    }`;
  const FS = "precision mediump float; varying vec3 color; void main() { gl_FragColor = vec4(color, 1.0); }";

  function startGl() {
    const gl = canvas.getContext("webgl", { antialias: true });
    if (!gl) return null;
    const program = (source) => {
      const p = gl.createProgram();
      for (const [kind, text] of [[gl.VERTEX_SHADER, source], [gl.FRAGMENT_SHADER, FS]]) {
        const s = gl.createShader(kind);
        gl.shaderSource(s, text); gl.compileShader(s);
        if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s));
        gl.attachShader(p, s);
      }
      gl.linkProgram(p);
      if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
      return p;
    };
    const buffer = (data) => {
      const b = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, b); gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      return b;
    };
    const padded = new Uint16Array(4 * N); // four-byte aligned rows
    const colors = new Uint8Array(4 * N);
    for (let i = 0; i < N; i++) {
      for (let k = 0; k < 3; k++) {
        padded[4 * i + k] = cloud.position[3 * i + k];
        colors[4 * i + k] = cloud.rgb[3 * i + k];
      }
    }
    const corner = [[0, -1], [1, -1], [0, 1], [0, 1], [1, -1], [1, 1]];
    const quads = new Float32Array(E * 6 * 13);
    for (let e = 0, o = 0; e < E; e++) {
      const s = edges.subarray(STRIDE * e, STRIDE * e + STRIDE), c = orderColor(s[8]);
      for (const [end, side] of corner) {
        quads.set([s[0], s[1], s[2], s[4], s[5], s[6], end, side, end ? s[7] : s[3], 0, ...c], o);
        o += 13;
      }
    }
    const points = program(POINTS_VS), lines = program(EDGES_VS);
    const buffers = { position: buffer(padded), rgb: buffer(colors), slot: buffer(slots), quads: buffer(quads) };
    const attribute = (p, name, b, size, type, norm, stride, offset) => {
      const at = gl.getAttribLocation(p, name);
      if (at < 0) return;
      gl.bindBuffer(gl.ARRAY_BUFFER, b); gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, size, type, norm, stride, offset);
    };
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0.98, 0.98, 0.97, 1);
    return function () {
      const m = matrix(canvas.width / canvas.height);
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      if (state.cloud && N) {
        gl.useProgram(points);
        const u = (name) => gl.getUniformLocation(points, name);
        gl.uniformMatrix4fv(u("view"), false, m);
        gl.uniform3fv(u("low"), meta.low); gl.uniform3fv(u("span"), meta.span);
        const palette = new Float32Array(30), shown = new Float32Array(10);
        meta.labels.forEach((label, i) => {
          palette.set(meta.label_colors[i], 3 * i); shown[i] = state.hidden.has(label) ? 0 : 1;
        });
        gl.uniform3fv(u("palette"), palette); gl.uniform1fv(u("shown"), shown);
        gl.uniform1f(u("byClass"), state.mode === "class" ? 1 : 0);
        gl.uniform1f(u("size"), state.size * (window.devicePixelRatio || 1));
        attribute(points, "position", buffers.position, 3, gl.UNSIGNED_SHORT, true, 8, 0);
        attribute(points, "rgb", buffers.rgb, 3, gl.UNSIGNED_BYTE, true, 4, 0);
        attribute(points, "slot", buffers.slot, 1, gl.UNSIGNED_BYTE, false, 0, 0);
        gl.drawArrays(gl.POINTS, 0, N);
      }
      if (state.skeleton && E) {
        gl.useProgram(lines);
        // Thin lines lie inside the wood: they are drawn through it
        if (!state.thick) gl.disable(gl.DEPTH_TEST);
        const u = (name) => gl.getUniformLocation(lines, name);
        gl.uniformMatrix4fv(u("view"), false, m);
        gl.uniform2f(u("pixels"), canvas.width / 2, canvas.height / 2);
        gl.uniform1f(u("thick"), state.thick ? 1 : 0);
        const f = gl.FLOAT;
        attribute(lines, "a", buffers.quads, 3, f, false, 52, 0);
        attribute(lines, "b", buffers.quads, 3, f, false, 52, 12);
        attribute(lines, "how", buffers.quads, 4, f, false, 52, 24);
        attribute(lines, "rgb", buffers.quads, 3, f, false, 52, 40);
        gl.drawArrays(gl.TRIANGLES, 0, 6 * E);
        gl.enable(gl.DEPTH_TEST);
      }
    };
  }

  // ---- 2D fallback ----------------------------------------------------------------------------
  function startFlat() {
    const ctx = canvas.getContext("2d");
    const step = Math.max(1, Math.floor(N / 40000));
    status.textContent = "WebGL is not available: a simpler view with fewer points";
    return function () {
      const w = canvas.width, h = canvas.height, m = matrix(w / h);
      const project = (x, y, z) => {
        const q = m[3] * x + m[7] * y + m[11] * z + m[15];
        if (q <= 0) return null;
        return [w / 2 * (1 + (m[0] * x + m[4] * y + m[8] * z + m[12]) / q),
          h / 2 * (1 - (m[1] * x + m[5] * y + m[9] * z + m[13]) / q)];
      };
      ctx.fillStyle = "#fafaf7"; ctx.fillRect(0, 0, w, h);
      for (let i = 0; state.cloud && i < N; i += step) {
        if (state.hidden.has(cloud.label[i])) continue;
        const at = [0, 1, 2].map((k) => meta.low[k] + cloud.position[3 * i + k] / 65535 * meta.span[k]);
        const p = project(...at);
        if (!p) continue;
        const c = state.mode === "class" ? meta.label_colors[slots[i]].map((v) => Math.round(255 * v))
          : [cloud.rgb[3 * i], cloud.rgb[3 * i + 1], cloud.rgb[3 * i + 2]];
        ctx.fillStyle = `rgb(${c[0]},${c[1]},${c[2]})`;
        ctx.fillRect(p[0], p[1], state.size, state.size);
      }
      for (let e = 0; state.skeleton && e < E; e++) {
        const s = edges.subarray(STRIDE * e, STRIDE * e + STRIDE);
        const p = project(s[0], s[1], s[2]), q = project(s[4], s[5], s[6]);
        if (!p || !q) continue;
        ctx.strokeStyle = `rgb(${orderColor(s[8]).map((v) => Math.round(255 * v)).join(",")})`;
        ctx.lineWidth = 2; ctx.beginPath(); ctx.moveTo(...p); ctx.lineTo(...q); ctx.stroke();
      }
    };
  }

  let paint = null;
  try { paint = startGl(); } catch (error) { console.warn(error); }
  paint = paint || startFlat();
  function draw() {
    const ratio = window.devicePixelRatio || 1;
    const w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (w && h && (canvas.width !== w || canvas.height !== h)) { canvas.width = w; canvas.height = h; }
    paint();
  }
  window.addEventListener("resize", redraw);
  redraw();
})();
