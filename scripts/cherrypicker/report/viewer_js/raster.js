// Points and tubes drawn into the pixels of a 2D canvas, with a depth for each.
//
// Where WebGL is drawn in software (a field laptop, a virtual machine), this is several times faster.

const MOST_PIXELS = 2.2e6; // drawn; a sharper screen is drawn coarser

export class Raster {
  constructor(canvas) {
    this.canvas = canvas;
    // Desynchronized: without waiting for the page's compositor, which takes longer than the drawing
    this.context = canvas.getContext("2d", { alpha: false, desynchronized: true });
  }

  // Follow the canvas's place on the page; true where its pixels changed.
  fit() {
    const wide = this.canvas.clientWidth, tall = this.canvas.clientHeight;
    const ratio = Math.min(window.devicePixelRatio || 1, Math.sqrt(MOST_PIXELS / Math.max(wide * tall, 1)));
    const width = Math.max(Math.round(wide * ratio), 1), height = Math.max(Math.round(tall * ratio), 1);
    this.ratio = ratio;
    if (width !== this.width || height !== this.height) this.resize(width, height);
  }

  resize(width, height) {
    this.width = this.canvas.width = width;
    this.height = this.canvas.height = height;
    this.image = this.context.createImageData(width, height);
    this.pixels = new Uint32Array(this.image.data.buffer);
    this.near = new Float32Array(width * height); // 1 / depth of what is drawn there
  }

  clear(color) {
    this.pixels.fill(color);
    this.near.fill(0);
  }

  show() { this.context.putImageData(this.image, 0, 0); }

  // Squares of `size` px; a point of colour 0 is left out. `m` is the 3 x 4 matrix of the camera.
  points(positions, colors, m, focal, size, clip) {
    const { pixels, near, width, height } = this;
    const [a, b, c, d, e, f, g, h, i, j, k, l] = m;
    const [nx, ny, nz, limit] = clip || [0, 0, 0, 1];
    const side = Math.max(Math.round(size * this.ratio), 1), half = side >> 1;
    const middleX = width / 2 - half, middleY = height / 2 - half;
    const lastX = width - side, lastY = height - side;
    for (let p = 0, o = 0; p < colors.length; p++, o += 3) {
      const color = colors[p];
      if (color === 0) continue;
      const x = positions[o], y = positions[o + 1], z = positions[o + 2];
      const depth = i * x + j * y + k * z + l;
      if (depth < 1e-4 || nx * x + ny * y + nz * z > limit) continue;
      const inverse = 1 / depth, scale = focal * inverse;
      const u = (middleX + (a * x + b * y + c * z + d) * scale) | 0;
      const v = (middleY - (e * x + f * y + g * z + h) * scale) | 0;
      if (u < 0 || v < 0 || u > lastX || v > lastY) continue;
      for (let row = v * width + u, end = row + side * width; row < end; row += width) {
        for (let at = row; at < row + side; at++) {
          if (inverse > near[at]) { near[at] = inverse; pixels[at] = color; }
        }
      }
    }
  }

  // A round rod between two places of the screen, [u, v, 1 / depth, half width in px] each. It is
  // shaded where it is `solid`; else it is drawn over all that lies before it.
  rod(from, to, color, solid, focal) {
    const along = Math.abs(to[0] - from[0]) >= Math.abs(to[1] - from[1]) ? 0 : 1, across = 1 - along;
    const [p, q] = from[along] <= to[along] ? [from, to] : [to, from];
    const run = q[along] - p[along], rise = q[across] - p[across];
    const slope = run > 1e-6 ? Math.hypot(run, rise) / run : 1;
    const { pixels, near, width, height } = this;
    const limits = [width, height], strides = [1, width];
    const first = Math.max(Math.floor(p[along]), 0), last = Math.min(Math.ceil(q[along]), limits[along] - 1);
    for (let s = first; s <= last; s++) {
      const t = run > 1e-6 ? Math.min(Math.max((s - p[along]) / run, 0), 1) : 0;
      const middle = p[across] + t * rise, inverse = p[2] + t * (q[2] - p[2]);
      const half = (p[3] + t * (q[3] - p[3])) * slope;
      const low = Math.max(Math.round(middle - half), 0);
      const high = Math.min(Math.round(middle + half - 1), limits[across] - 1);
      for (let r = low; r <= high; r++) {
        const at = s * strides[along] + r * strides[across];
        if (!solid) { pixels[at] = color; continue; }
        const off = Math.min(Math.abs(r + 0.5 - middle) / half, 1), bulge = Math.sqrt(1 - off * off);
        const surface = inverse / Math.max(1 - (half / slope / focal) * bulge, 0.1);
        if (surface > near[at]) { near[at] = surface; pixels[at] = shaded(color, bulge); }
      }
    }
  }

  // A ball where rods meet, or a mark.
  ball(place, color, solid, focal) {
    const [u, v, inverse, half] = place;
    const { pixels, near, width, height } = this;
    const top = Math.max(Math.round(v - half), 0), bottom = Math.min(Math.round(v + half - 1), height - 1);
    const left = Math.max(Math.round(u - half), 0), right = Math.min(Math.round(u + half - 1), width - 1);
    for (let y = top; y <= bottom; y++) {
      for (let x = left; x <= right; x++) {
        const off = ((x + 0.5 - u) ** 2 + (y + 0.5 - v) ** 2) / (half * half);
        if (off > 1) continue;
        const at = y * width + x;
        if (!solid) { pixels[at] = color; continue; }
        const bulge = Math.sqrt(1 - off), surface = inverse / Math.max(1 - (half / focal) * bulge, 0.1);
        if (surface > near[at]) { near[at] = surface; pixels[at] = shaded(color, bulge); }
      }
    }
  }
}

function shaded(color, bulge) {
  const light = 0.5 + 0.5 * bulge;
  const r = (color & 255) * light, g = ((color >> 8) & 255) * light, b = ((color >> 16) & 255) * light;
  return (0xff000000 | (b << 16) | (g << 8) | r) >>> 0;
}
