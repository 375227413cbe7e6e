// Mouse, touch and keys on the picture.

const TURN = 0.008; // rad for each pixel
const KEY_TURN = 0.1; // rad
const KEY_MOVE = 0.03; // of what the picture shows

/** Listens on `canvas`; `page()` returns the page, or null, and `keys` what other keys do. */
export function listen(canvas, page, keys) {
  const pointers = new Map();
  let holding = false;
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  };
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event);
    if (pointers.size === 1) holding = page()?.grab(...place(event)) ?? false;
    canvas.classList.add("held");
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before || !page()) return;
    const apart = pointers.size === 2 ? spread() : 0;
    pointers.set(event.pointerId, event);
    if (pointers.size === 2) page().zoom(spread() / Math.max(apart, 1));
    else if (holding) page().drag(...place(event));
    else page().orbit(-TURN * (event.clientX - before.clientX), TURN * (event.clientY - before.clientY));
  });
  const end = (event) => {
    pointers.delete(event.pointerId);
    if (pointers.size > 0) return;
    if (holding) page()?.release();
    holding = false;
    canvas.classList.remove("held");
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const pixels = event.deltaMode === WheelEvent.DOM_DELTA_PIXEL ? event.deltaY : 30 * event.deltaY;
      page()?.zoom(Math.exp(-0.0015 * pixels));
    },
    { passive: false },
  );
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || !page()) return;
    const [x, y] = arrows[event.key] ?? [0, 0];
    if (event.key in arrows && event.shiftKey) page().nudge(KEY_MOVE * x, KEY_MOVE * y);
    else if (event.key in arrows) page().orbit(KEY_TURN * x, KEY_TURN * y);
    else if (event.key === "+" || event.key === "=") page().zoom(1.1);
    else if (event.key === "-") page().zoom(1 / 1.1);
    else if (keys[event.key.toLowerCase()]) keys[event.key.toLowerCase()]();
    else return;
    event.preventDefault();
  });
}
