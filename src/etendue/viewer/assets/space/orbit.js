// A camera that orbits a point: its matrices, and pointers, wheel and keys that move it.

export const add = (a, b, t = 1) => a.map((v, k) => v + t * b[k]);
export const dot = (a, b) => a.reduce((sum, v, k) => sum + v * b[k], 0);
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const norm = (a) => Math.hypot(...a);
export const unit = (a) => a.map((v) => v / (norm(a) || 1));

const STEP = 0.12;

export class Orbit {
  constructor(canvas, changed, picked) {
    Object.assign(this, { canvas, changed, picked, pointers: new Map() });
    this.listen();
  }

  /** See a scene from a camera {origin, target, up}; fov in degrees, size: half the diagonal. */
  place({ origin, target, up, fov = 45, size }) {
    Object.assign(this, { target: [...target], up: unit(up), size, fov: (Math.min(fov ?? 45, 75) * Math.PI) / 180 });
    this.offset = add(origin, target, -1);
    this.home = { origin, target, up, fov, size };
    this.changed();
  }

  get eye() { return add(this.target, this.offset); }

  frame() {
    const ahead = unit(this.offset.map((v) => -v));
    let right = cross(ahead, this.up);
    if (norm(right) < 1e-6) right = cross(ahead, Math.abs(ahead[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]);
    right = unit(right);
    return { right, up: cross(right, ahead), ahead };
  }

  /** View and projection, column by column. */
  matrix() {
    const { right, up, ahead } = this.frame();
    const eye = this.eye;
    const near = Math.max(this.size * 1e-3, norm(this.offset) * 5e-3);
    const far = norm(this.offset) + 8 * this.size;
    const height = 1 / Math.tan(this.fov / 2);
    const width = height / (this.canvas.clientWidth / Math.max(1, this.canvas.clientHeight));
    const rows = [right.map((v) => v * width), up.map((v) => v * height), ahead.map((v) => (v * (far + near)) / (far - near)), ahead];
    const last = [0, 0, (-2 * far * near) / (far - near), 0];
    const result = new Float32Array(16);
    rows.forEach((row, r) => {
      for (let c = 0; c < 3; c += 1) result[4 * c + r] = row[c];
      result[12 + r] = last[r] - dot(row, eye);
    });
    return result;
  }

  /** The ray through a place, 0 to 1 from the top left corner. */
  ray(x, y) {
    const { right, up, ahead } = this.frame();
    const height = Math.tan(this.fov / 2);
    const width = (height * this.canvas.clientWidth) / Math.max(1, this.canvas.clientHeight);
    return { origin: this.eye, direction: unit(add(add(ahead, right, (2 * x - 1) * width), up, (1 - 2 * y) * height)) };
  }

  turn(right, up) {
    const rotate = (vector, axis, angle) => {
      const [c, s] = [Math.cos(angle), Math.sin(angle)];
      return add(add(vector.map((v) => v * c), cross(axis, vector), s), axis, dot(axis, vector) * (1 - c));
    };
    this.offset = rotate(this.offset, this.up, -right);
    const side = unit(cross(this.up, this.offset));
    const angle = Math.acos(Math.max(-1, Math.min(1, dot(unit(this.offset), this.up))));
    const wanted = Math.max(0.03, Math.min(Math.PI - 0.03, angle - up));
    this.offset = rotate(this.offset, side, wanted - angle);
    this.changed();
  }

  shift(right, up) {
    const frame = this.frame();
    const step = norm(this.offset) * Math.tan(this.fov / 2) * 2;
    this.target = add(add(this.target, frame.right, right * step), frame.up, up * step);
    this.changed();
  }

  approach(by) {
    const least = this.size * 1e-3;
    const most = this.size * 50;
    const length = Math.max(least, Math.min(most, norm(this.offset) * Math.exp(-by)));
    this.offset = unit(this.offset).map((v) => v * length);
    this.changed();
  }

  listen() {
    const { canvas } = this;
    const at = (event) => {
      const box = canvas.getBoundingClientRect();
      return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    };
    canvas.style.touchAction = 'none';
    canvas.addEventListener('contextmenu', (event) => event.preventDefault());
    canvas.addEventListener('pointerdown', (event) => {
      canvas.focus({ preventScroll: true });
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, far: 0 });
      event.preventDefault();
    });
    canvas.addEventListener('pointermove', (event) => {
      const pointer = this.pointers.get(event.pointerId);
      if (!pointer) { this.picked(...at(event), false); return; }
      const height = canvas.clientHeight || 1;
      const [dx, dy] = [(event.clientX - pointer.x) / height, (event.clientY - pointer.y) / height];
      const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
      if (other) {
        const before = Math.hypot(pointer.x - other.x, pointer.y - other.y);
        const after = Math.hypot(event.clientX - other.x, event.clientY - other.y);
        if (before > 8 && after > 8) this.approach(Math.log(after / before));
        this.shift(-dx / 2, dy / 2);
      } else if (event.buttons & 2 || event.shiftKey) {
        this.shift(-dx, dy);
      } else {
        this.turn(dx * 4, dy * 4);
      }
      pointer.far += Math.hypot(event.clientX - pointer.x, event.clientY - pointer.y);
      [pointer.x, pointer.y] = [event.clientX, event.clientY];
    });
    for (const name of ['pointerup', 'pointercancel']) {
      canvas.addEventListener(name, (event) => {
        const pointer = this.pointers.get(event.pointerId);
        this.pointers.delete(event.pointerId);
        if (name === 'pointerup' && pointer && pointer.far < 4) this.picked(...at(event), true);
      });
    }
    canvas.addEventListener('wheel', (event) => {
      event.preventDefault();
      this.approach(-event.deltaY * (event.deltaMode === 1 ? 16 : 1) * 0.0015);
    }, { passive: false });
    canvas.addEventListener('keydown', (event) => {
      const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
      if (event.ctrlKey || event.altKey || event.metaKey) return;
      if (event.key in arrows) {
        const [x, y] = arrows[event.key].map((v) => v * STEP);
        if (event.shiftKey) this.shift(x, y);
        else this.turn(x, y);
      } else if (event.key === '+' || event.key === '=') this.approach(STEP);
      else if (event.key === '-') this.approach(-STEP);
      else if (event.key === 'Home') this.place(this.home);
      else if (event.key === 'Enter' || event.key === 'p') this.picked(0.5, 0.5, true);
      else return;
      event.preventDefault();
    });
  }
}

/** Distance along a ray to a triangle (nine numbers), null if it is missed. */
export function meet({ origin, direction }, t) {
  const a = t.slice(0, 3);
  const [ab, ac] = [add(t.slice(3, 6), a, -1), add(t.slice(6, 9), a, -1)];
  const p = cross(direction, ac);
  const determinant = dot(ab, p);
  if (Math.abs(determinant) < 1e-20) return null;
  const from = add(origin, a, -1);
  return dot(ac, cross(from, ab)) / determinant;
}
