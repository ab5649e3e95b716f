// The picture: frames of both sides, the divider, pointer, touch and keys.

const ORBIT = 2.6; // radians across the picture's height
const KEYS = {
  ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
};
const FLY = { KeyD: [1, 0, 0], KeyA: [-1, 0, 0], KeyE: [0, 1, 0], KeyQ: [0, -1, 0], KeyW: [0, 0, 1], KeyS: [0, 0, -1] };
// By what the key prints, wherever a keyboard has it.
const OTHER = { '+': { dolly: 1 }, '=': { dolly: 1 }, '-': { dolly: -1 },
  '[': { zoom: -0.5 }, ']': { zoom: 0.5 }, ',': { roll: -1 }, '.': { roll: 1 } };

export class Stage {
  constructor(connection, actions) {
    this.connection = connection;
    this.actions = actions;
    this.size = [4, 3];
    for (const id of ['stage', 'picture', 'a', 'b', 'overlay', 'divider', 'slider']) this[id] = document.getElementById(id);
    this.pointers = new Map();
    this.pending = {};
    this.held = new Map(); // by code, what the key does
    this.decoding = Promise.resolve();
    connection.on('frame', (message, view) => this.draw(message, view));
    new ResizeObserver(() => this.fit()).observe(this.stage);
    this.slider.addEventListener('input', () => this.divide());
    this.listen();
  }

  // ---- frames

  draw(message, view) {
    const blob = new Blob([view], { type: message.format });
    // One after the other, so that a picture never replaces a later one.
    this.decoding = this.decoding.then(() => createImageBitmap(blob)).then((bitmap) => {
      const canvas = this[message.side];
      const [width, height] = this.size;
      if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
      const context = canvas.getContext('2d', { alpha: false });
      context.imageSmoothingQuality = 'high';
      context.drawImage(bitmap, 0, 0, width, height);
      bitmap.close();
      this.stage.dataset.frame = message.frame;
      this.stage.dataset[`${message.side}Frames`] = Number(this.stage.dataset[`${message.side}Frames`] ?? 0) + 1;
      this.actions.drawn(message);
    }).catch(() => {}).finally(() => this.connection.send('drawn', { frame: message.frame }));
  }

  resize(size) {
    if (!size || (size[0] === this.size[0] && size[1] === this.size[1])) return;
    this.size = size;
    this.overlay.setAttribute('viewBox', `0 0 ${size[0]} ${size[1]}`);
    this.fit();
  }

  fit() {
    const [width, height] = this.size;
    const box = this.stage.getBoundingClientRect();
    const scale = Math.min(box.width / width, box.height / height);
    Object.assign(this.picture.style, {
      width: `${width * scale}px`, height: `${height * scale}px`,
      left: `${(box.width - width * scale) / 2}px`, top: `${(box.height - height * scale) / 2}px`,
    });
  }

  compare(on) {
    for (const element of [this.b, this.divider, document.getElementById('slider-row')]) element.hidden = !on;
    this.divide();
  }

  divide() {
    this.b.style.clipPath = `inset(0 0 0 ${this.slider.value}%)`;
    this.divider.style.left = `${this.slider.value}%`;
  }

  // ---- movements, sent once for each picture of the screen

  move(change) {
    if (document.body.classList.contains('still')) return; // a picture of a file has no camera
    for (const [name, values] of Object.entries(change)) {
      const before = this.pending[name];
      this.pending[name] = !before ? values : Array.isArray(values) ? values.map((v, k) => v + before[k]) : values + before;
    }
    if (!this.scheduled) {
      this.scheduled = true;
      requestAnimationFrame(() => {
        this.scheduled = false;
        this.connection.send('camera', this.pending);
        this.pending = {};
      });
    }
  }

  place(event) {
    const box = this.picture.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  }

  listen() {
    const { stage } = this;
    stage.addEventListener('contextmenu', (event) => event.preventDefault());
    stage.addEventListener('pointerdown', (event) => {
      if (event.target.closest('.large')) return;
      stage.focus({ preventScroll: true });
      stage.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, far: 0, at: this.place(event) });
      const [x] = this.place(event);
      this.dividing = !this.b.hidden && this.pointers.size === 1 && Math.abs(x * 100 - this.slider.value) < 2.5;
      event.preventDefault();
    });
    stage.addEventListener('pointermove', (event) => this.drag(event));
    for (const name of ['pointerup', 'pointercancel']) {
      stage.addEventListener(name, (event) => {
        const pointer = this.pointers.get(event.pointerId);
        this.pointers.delete(event.pointerId);
        if (name === 'pointerup' && pointer && pointer.far < 4 && !this.dividing && event.button === 0) this.pick(...this.place(event));
      });
    }
    stage.addEventListener('wheel', (event) => {
      if (event.target.closest('.large')) return;
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 16 : 1;
      this.move({ dolly: -event.deltaY * lines * 0.0015 });
    }, { passive: false });
    stage.addEventListener('keydown', (event) => this.press(event));
    stage.addEventListener('keyup', (event) => this.held.delete(event.code));
    stage.addEventListener('blur', () => this.held.clear());
  }

  drag(event) {
    const pointer = this.pointers.get(event.pointerId);
    if (!pointer) return;
    const height = this.picture.clientHeight || 1;
    const [dx, dy] = [(event.clientX - pointer.x) / height, (event.clientY - pointer.y) / height];
    const others = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, other]) => other);
    if (this.dividing) {
      this.slider.value = 100 * this.place(event)[0];
      this.divide();
    } else if (others.length) {
      const [other] = others;
      const before = Math.hypot(pointer.x - other.x, pointer.y - other.y);
      const after = Math.hypot(event.clientX - other.x, event.clientY - other.y);
      if (before > 8 && after > 8) this.move({ dolly: Math.log(after / before) });
      this.move({ pan: [-dx / 2, dy / 2] });
    } else if (event.buttons & 2 || event.shiftKey) {
      this.move({ pan: [-dx, dy] });
    } else if (event.buttons & 4 || event.ctrlKey) {
      this.move({ look: [dx, -dy] });
    } else {
      // Around what is under the pointer where the drag began.
      if (!pointer.grabbed && this.inside(...pointer.at)) this.move({ grab: pointer.at });
      pointer.grabbed = true;
      this.move({ orbit: [-dx * ORBIT, dy * ORBIT] });
    }
    pointer.far += Math.hypot(event.clientX - pointer.x, event.clientY - pointer.y);
    [pointer.x, pointer.y] = [event.clientX, event.clientY];
  }

  pick(x, y) {
    if (this.inside(x, y)) this.connection.send('pick', { x, y });
  }

  inside(x, y) {
    return x >= 0 && x <= 1 && y >= 0 && y <= 1;
  }

  press(event) {
    // A character that needs AltGr on a keyboard, such as [, comes with Alt and Ctrl.
    const prints = event.key in OTHER && !event.metaKey && (!event.ctrlKey || event.getModifierState('AltGraph'));
    if (event.target !== this.stage || event.metaKey || (event.altKey && !prints)) return;
    const { code } = event;
    if (prints || code in KEYS || (code in FLY && !event.ctrlKey)) {
      if (!this.held.has(code)) {
        this.held.set(code, prints ? event.key : code);
        this.step({ key: this.held.get(code), shiftKey: event.shiftKey, ctrlKey: event.ctrlKey }, 1 / 12); // at once
        if (!this.turning) { this.turning = true; this.last = performance.now(); requestAnimationFrame((now) => this.turn(now)); }
      }
      this.modifiers = { shiftKey: event.shiftKey, ctrlKey: event.ctrlKey };
    } else if (event.ctrlKey) {
      return;
    } else if (event.key === '?') {
      document.getElementById('help').showModal();
    } else if (code in this.actions.keys) {
      this.actions.keys[code]();
    } else if (code === 'KeyP') {
      this.pick(0.5, 0.5);
    } else if (code === 'KeyC' || code === 'KeyX') {
      this.slider.value = Number(this.slider.value) + (code === 'KeyC' ? -4 : 4);
      this.divide();
    } else {
      return;
    }
    event.preventDefault();
  }

  turn(now) {
    const passed = Math.min((now - this.last) / 1000, 0.1);
    this.last = now;
    for (const key of this.held.values()) this.step({ key, ...this.modifiers }, passed);
    this.turning = this.held.size > 0;
    if (this.turning) requestAnimationFrame((next) => this.turn(next));
  }

  step({ key, shiftKey, ctrlKey }, passed) {
    if (key in KEYS) {
      const [x, y] = KEYS[key];
      if (shiftKey) this.move({ pan: [x * passed * 0.5, y * passed * 0.5] });
      else if (ctrlKey) this.move({ look: [x * passed * 0.8, y * passed * 0.8] });
      else this.move({ orbit: [x * passed * 1.2, y * passed * 1.2] });
    } else if (key in FLY) {
      this.move({ fly: FLY[key].map((v) => v * passed * (shiftKey ? 1.2 : 0.4)) });
    } else {
      this.move(Object.fromEntries(Object.entries(OTHER[key]).map(([name, value]) => [name, value * passed])));
    }
  }
}
