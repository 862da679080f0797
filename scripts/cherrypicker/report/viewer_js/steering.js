// Mouse, fingers and arrow keys move the eye; a press that does not move is a click.

const CLICK_PX = 4;
const TURN = 0.008, KEY_TURN = 0.1, KEY_PAN = 0.04;

export function steer(scene, onClick) {
  const { canvas, camera } = scene, pointers = new Map();
  let moved = 0;
  const now = (change) => { scene.flight = null; change(); scene.redraw(); };

  canvas.addEventListener("pointerdown", (e) => {
    canvas.setPointerCapture(e.pointerId);
    if (!pointers.size) moved = 0;
    pointers.set(e.pointerId, [e.clientX, e.clientY]);
  });
  canvas.addEventListener("pointerup", (e) => {
    const isClick = pointers.size === 1 && moved <= CLICK_PX && e.button === 0;
    pointers.delete(e.pointerId);
    const box = canvas.getBoundingClientRect();
    if (isClick) onClick(e.clientX - box.left, e.clientY - box.top);
  });
  canvas.addEventListener("pointercancel", (e) => pointers.delete(e.pointerId));
  canvas.addEventListener("pointermove", (e) => {
    const last = pointers.get(e.pointerId);
    if (!last) return;
    const dx = e.clientX - last[0], dy = e.clientY - last[1];
    moved += Math.hypot(dx, dy);
    pointers.set(e.pointerId, [e.clientX, e.clientY]);
    if (moved <= CLICK_PX) return;
    const tall = canvas.clientHeight;
    now(() => {
      if (pointers.size === 2) {
        const other = [...pointers].find(([id]) => id !== e.pointerId)[1];
        const before = Math.hypot(last[0] - other[0], last[1] - other[1]);
        const after = Math.hypot(e.clientX - other[0], e.clientY - other[1]);
        camera.zoom(before / Math.max(after, 1));
        camera.pan(dx / 2 / tall, dy / 2 / tall);
      } else if (e.shiftKey || e.buttons & 6) camera.pan(dx / tall, dy / tall);
      else camera.turn(dx * TURN, dy * TURN);
    });
  });
  canvas.addEventListener("wheel", (e) => {
    e.preventDefault();
    now(() => camera.zoom(Math.exp(Math.sign(e.deltaY) * Math.min(Math.abs(e.deltaY), 120) * 0.0015)));
  }, { passive: false });
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("keydown", (e) => {
    const arrow = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[e.key];
    if (arrow && e.shiftKey) now(() => camera.pan(KEY_PAN * arrow[0], KEY_PAN * arrow[1]));
    else if (arrow) now(() => camera.turn(-KEY_TURN * arrow[0], KEY_TURN * arrow[1]));
    else if (e.key === "+" || e.key === "=") now(() => camera.zoom(0.87));
    else if (e.key === "-") now(() => camera.zoom(1.15));
    else if (e.key === "Home" || e.key === "0") now(() => camera.reset());
    else return;
    e.preventDefault();
  });
}
