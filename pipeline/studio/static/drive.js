// Teleop: W A S D X space Q as in the terminal, and a touch pad; a heartbeat repeats the current speed.

const HEARTBEAT_MS = 150, SOONEST_MS = 50;
const clip = (value, limit) => Math.max(-limit, Math.min(limit, value));

export class Drive {
  /** `send` takes an input, `show` the current speeds. */
  constructor(send, show) {
    Object.assign(this, { send, show, v: 0, w: 0, last: 0 });
    this.steps = { v: 0.01, w: 0.1, max_v: 0.22, max_w: 2.84 };
    setInterval(() => this.v || this.w ? this.beat() : 0, HEARTBEAT_MS);
    addEventListener("blur", () => this.halt());
    document.addEventListener("visibilitychange", () => document.hidden && this.halt());
  }

  learn({ step_v, step_w, limits }) {
    this.steps = { v: step_v, w: step_w, ...limits };
    this.forget();
  }

  /** One key; false when it does not drive. */
  press(key) {
    const { v, w, max_v, max_w } = this.steps;
    if (key === "x" || key === " ") this.stop();
    else if (key === "q") this.release();
    // Whole steps, so that the same number back gives exactly zero.
    else if (key === "w" || key === "s") this.ask(clip((Math.round(this.v / v) + (key === "w" ? 1 : -1)) * v, max_v), this.w);
    else if (key === "a" || key === "d") this.ask(this.v, clip((Math.round(this.w / w) + (key === "a" ? 1 : -1)) * w, max_w));
    else return false;
    return true;
  }

  ask(v, w) {
    this.v = Number(v.toFixed(4)) || 0;
    this.w = Number(w.toFixed(4)) || 0;
    // Touch events are more frequent than needed: the heartbeat sends what is skipped here.
    if ((this.v || this.w) && performance.now() - this.last < SOONEST_MS) this.show(this.v, this.w);
    else this.beat();
  }

  beat() {
    this.last = performance.now();
    this.send({ do: "drive", v: this.v, w: this.w });
    this.show(this.v, this.w);
  }

  stop() {
    this.forget();
    this.send({ do: "stop" });
  }

  /** Hand back to the task. */
  release() {
    this.forget();
    this.send({ do: "release" });
  }

  /** Stop when the page is no longer visible. */
  halt() {
    if (this.v || this.w) this.stop();
  }

  /** End teleop; a task takes over. */
  forget() {
    this.v = this.w = 0;
    this.show(0, 0);
  }

  /** A joystick: up is forward, finer near the centre, releasing stops. */
  attach(pad, knob) {
    const move = (event) => {
      if (pad.matches(":disabled *")) return;
      const box = pad.getBoundingClientRect(), reach = box.width / 2;
      let x = (event.clientX - box.left) / reach - 1, y = 1 - (event.clientY - box.top) / reach;
      const far = Math.hypot(x, y);
      if (far > 1) [x, y] = [x / far, y / far];
      knob.style.transform = `translate(${x * reach * 0.6}px, ${-y * reach * 0.6}px)`;
      const fine = (share) => Math.abs(share) < 0.12 ? 0 : share * Math.abs(share);
      this.ask(fine(y) * this.steps.max_v, -fine(x) * this.steps.max_w / 2);
    };
    const end = () => {
      if (!pad.classList.contains("held")) return;
      pad.classList.remove("held");
      knob.style.transform = "";
      this.stop();
    };
    pad.addEventListener("pointerdown", (event) => {
      pad.setPointerCapture(event.pointerId);
      pad.classList.add("held");
      move(event);
    });
    pad.addEventListener("pointermove", (event) => pad.classList.contains("held") && move(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) pad.addEventListener(kind, end);
    pad.addEventListener("keydown", (event) => {
      const key = { ArrowUp: "w", ArrowDown: "s", ArrowLeft: "a", ArrowRight: "d" }[event.key];
      if (!key || pad.matches(":disabled *")) return;
      this.press(key);
      event.preventDefault();
      event.stopPropagation();
    });
  }
}
