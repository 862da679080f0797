// The eye that turns around a place, and its words in the page's address.

const OPENING = 0.35; // half of the vertical field of view, radians
const STEEPEST = 1.55;

export class OrbitCamera {
  // home: {center: [x, y, z], reach: half of what is shown}
  constructor(home) {
    this.home = home;
    this.reset();
  }

  reset() {
    this.azimuth = 0.6; this.elevation = 0.2;
    this.distance = this.home.reach / Math.sin(OPENING); // a ball of that radius fills the height
    this.target = this.home.center.slice();
  }

  axes() {
    const ca = Math.cos(this.azimuth), sa = Math.sin(this.azimuth);
    const ce = Math.cos(this.elevation), se = Math.sin(this.elevation);
    return { back: [ce * sa, -ce * ca, se], right: [ca, sa, 0], up: [-se * sa, se * ca, ce] };
  }

  // Rows right, up and forward with their offsets: 12 numbers.
  matrix() {
    const { back, right, up } = this.axes(), forward = back.map((v) => -v);
    const eye = this.target.map((t, i) => t + this.distance * back[i]);
    return [right, up, forward].flatMap((row) => [...row, -dot(row, eye)]);
  }

  focal(height) { return height / 2 / Math.tan(OPENING); }

  turn(right, up) {
    this.azimuth -= right;
    this.elevation = Math.min(STEEPEST, Math.max(-STEEPEST, this.elevation + up));
  }

  // Move the target by shares of the view's height.
  pan(dx, dy) {
    const { right, up } = this.axes(), k = 2 * Math.tan(OPENING) * this.distance;
    this.target = this.target.map((t, i) => t - k * (dx * right[i] - dy * up[i]));
  }

  zoom(factor) {
    const { reach } = this.home;
    this.distance = Math.min(40 * reach, Math.max(0.02 * reach, this.distance * factor));
  }

  state() { return [this.azimuth, this.elevation, this.distance, ...this.target]; }

  set(numbers) {
    if (numbers.length !== 6 || !numbers.every(Number.isFinite) || !(numbers[2] > 0)) return false;
    [this.azimuth, this.elevation, this.distance] = numbers;
    this.target = numbers.slice(3);
    return true;
  }
}

export function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// "#view=0.6,0.2,...&branch=3" <-> {view: "0.6,0.2,...", branch: "3"}
export function readHash(text) { return Object.fromEntries(new URLSearchParams(text.replace(/^#/, ""))); }

export function writeHash(values) {
  const kept = Object.entries(values).filter(([, value]) => value !== "" && value != null);
  return "#" + kept.map(([name, value]) => `${name}=${encodeURIComponent(value).replace(/%2C/g, ",")}`).join("&");
}
