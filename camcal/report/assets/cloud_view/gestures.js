// Mouse, touch and keys, as changes of the viewpoint. `act` has changed(), clicked(x, y) and centred(x, y).

const STILL = 4; // pixels a pointer may move for a click
const TURN = 0.006; // radians per pixel

class Gestures {
  constructor(canvas, viewpoint, act) {
    Object.assign(this, { canvas, viewpoint, act, pointers: new Map(), moved: 0 });
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", (event) => this.#up(event));
    canvas.addEventListener("pointercancel", (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("dblclick", (event) => act.centred(event.offsetX, event.offsetY));
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
  }

  #down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.canvas.focus();
    this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (this.pointers.size === 1) this.moved = 0;
  }

  #move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const spread = this.#spread();
    const now = [event.offsetX, event.offsetY];
    const [right, down] = [now[0] - before[0], now[1] - before[1]];
    this.pointers.set(event.pointerId, now);
    this.moved += Math.hypot(right, down);
    if (this.moved <= STILL && this.pointers.size === 1) return;
    if (this.pointers.size > 1) {
      this.viewpoint.pan(right / 2, down / 2);
      this.viewpoint.zoom(this.#spread() / spread);
    } else if (event.shiftKey || event.buttons & 6) {
      this.viewpoint.pan(right, down);
    } else {
      this.viewpoint.orbit(TURN * right, TURN * down);
    }
    this.act.changed();
  }

  #up(event) {
    const alone = this.pointers.size === 1;
    this.pointers.delete(event.pointerId);
    if (alone && this.moved <= STILL && event.button === 0) this.act.clicked(event.offsetX, event.offsetY);
  }

  // How far two fingers are apart.
  #spread() {
    const [one, other] = [...this.pointers.values()];
    return other ? Math.max(Math.hypot(one[0] - other[0], one[1] - other[1]), 1) : 1;
  }

  #wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : 1;
    this.viewpoint.zoom(Math.exp(-0.0015 * clamp(event.deltaY * lines, -400, 400)));
    this.act.changed();
  }
}
