// Parameters of the scene as a tree: group, element, parameter; a field for each kind of value.

const GROUPS = { light: 'Lights', material: 'Materials and textures', medium: 'Media', shape: 'Places of shapes' };

const encode = (c) => (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055);
const decode = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
const hex = (rgb) => `#${rgb.map((c) => Math.round(255 * encode(Math.min(1, Math.max(0, c)))).toString(16).padStart(2, '0')).join('')}`;
const linear = (text) => [1, 3, 5].map((k) => decode(parseInt(text.slice(k, k + 2), 16) / 255));
const shown = (value) => (Array.isArray(value) ? value.map((v) => Number(v.toPrecision(5))).join(' ') : String(value));

/** A transform as the place of its origin; the other fields move and scale relative to what it is now. */
const place = (m) => (m.length === 16 ? [m[3], m[7], m[11]] : [m[2], m[5]]);

function moved(matrix, at) {
  const m = [...matrix];
  if (m.length === 16) [m[3], m[7], m[11]] = at;
  else [m[2], m[5]] = at;
  return m;
}

function scaled(matrix, factor) {
  const side = matrix.length === 16 ? 4 : 3;
  return matrix.map((v, k) => (k % side < side - 1 && k < side * (side - 1) ? v * factor : v));
}

function turned(matrix, axis, degrees) {
  const [c, s] = [Math.cos(degrees * Math.PI / 180), Math.sin(degrees * Math.PI / 180)];
  const [i, j] = [[1, 2], [2, 0], [0, 1]][axis];
  const m = [...matrix];
  for (let column = 0; column < 3; column += 1) {
    m[4 * i + column] = c * matrix[4 * i + column] - s * matrix[4 * j + column];
    m[4 * j + column] = s * matrix[4 * i + column] + c * matrix[4 * j + column];
  }
  return m;
}

export default function (host) {
  const { make, fillIn, isTyping, numeric, numerics: typed } = host;
  const list = make('div');
  const changes = make('ul', { class: 'list' });
  const all = make('button', { type: 'button', click: () => host.send('reset') }, 'Reset all');
  const filter = make('input', { type: 'text', placeholder: 'part of a name', autocomplete: 'off', spellcheck: 'false', input: () => { rebuild(true); fill(); } });
  const note = make('p', { class: 'soft' });
  const row = make('div', { class: 'row' }, all);
  host.element.append(note, make('label', {}, make('span', {}, 'Find'), filter), list, make('div', {}, make('strong', {}, 'Changes'), changes, row));

  let parameters = [];
  let rows = new Map();
  let built = '';

  const set = (key, value) => host.send('set', { key, value });

  /** A field for a parameter; `fill(value)` shows a value in it. */
  function field(parameter) {
    const { key, kind, label, least, most } = parameter;
    const name = label.replaceAll('.', ' › ').replaceAll('_', ' ');
    const text = (attributes = {}) => make('input', { type: 'text', autocomplete: 'off', spellcheck: 'false', 'aria-label': `${parameter.element} ${name}`, ...attributes });
    const body = make('div', { class: 'row' });
    let fill;
    if (kind === 'colour') {
      const colour = make('input', { type: 'color', 'aria-label': `${parameter.element} ${name}, colour`, change: () => {
        // The strength beyond one is kept, as of lights.
        const strength = Math.max(1, ...parameter.value);
        set(key, linear(colour.value).map((v) => v * strength));
      } });
      const numbers = text({ inputmode: 'decimal', change: () => set(key, typed(numbers.value)) });
      body.append(colour, make('div', { class: 'grow' }, numbers));
      fill = (value) => { colour.value = hex(value.map((v) => v / Math.max(1, ...value))); fillIn(numbers, shown(value)); };
    } else if (kind === 'number') {
      const number = text({ inputmode: 'decimal', change: () => set(key, numeric(number.value)) });
      if (least !== undefined && most !== undefined) {
        const range = make('input', { type: 'range', min: least, max: most, step: (most - least) / 200, 'aria-label': `${parameter.element} ${name}`, change: () => set(key, Number(range.value)) });
        body.append(make('div', { class: 'grow' }, range), make('div', { style: 'width: 5rem' }, number));
        fill = (value) => { fillIn(range, value); fillIn(number, shown(value)); };
      } else {
        body.append(make('div', { class: 'grow' }, number));
        fill = (value) => fillIn(number, shown(value));
      }
    } else if (kind === 'vector') {
      const numbers = text({ inputmode: 'decimal', change: () => set(key, typed(numbers.value)) });
      body.append(make('div', { class: 'grow' }, numbers));
      fill = (value) => fillIn(numbers, shown(value));
    } else if (kind === 'texture') {
      const file = text({ placeholder: 'picture file', change: () => set(key, file.value) });
      body.append(make('div', { class: 'grow' }, file));
      fill = (value) => { fillIn(file, String(value).includes(' x ') ? '' : value); file.placeholder = `picture file (now ${value})`; };
    } else {
      const at = text({ inputmode: 'decimal', change: () => {
        const to = typed(at.value);
        const count = place(parameter.value).length;
        if (to.length === count && to.every(Number.isFinite)) set(key, moved(parameter.value, to));
        else host.say(`A place is ${count} numbers, such as ${shown(place(parameter.value))}, not '${at.value}'.`, 'error');
      } });
      const size = text({ inputmode: 'decimal', placeholder: '× 1', change: () => {
        const by = numeric(size.value);
        if (Number.isFinite(by)) set(key, scaled(parameter.value, by));
        else host.say(`Scale by a number, such as 1.5, not '${size.value}'.`, 'error');
        size.value = '';
      } });
      body.append(make('label', { class: 'grow' }, make('span', {}, 'at'), at), make('label', { style: 'width: 4rem' }, make('span', {}, 'scale by'), size));
      if (parameter.value.length === 16) {
        const turn = text({ inputmode: 'decimal', placeholder: 'y 15', change: () => {
          const [axis, degrees] = turn.value.trim().split(/\s+/);
          const index = ['x', 'y', 'z'].indexOf(axis);
          const by = numeric(degrees ?? '');
          if (index >= 0 && Number.isFinite(by)) set(key, turned(parameter.value, index, by));
          else host.say(`Turn by an axis and degrees, such as y 15, not '${turn.value}'.`, 'error');
          turn.value = '';
        } });
        body.append(make('label', { style: 'width: 4.5rem' }, make('span', {}, 'turn by'), turn));
      }
      fill = (value) => fillIn(at, shown(place(value)));
    }
    const reset = make('button', { type: 'button', title: 'Back to the value of the file', click: () => host.send('reset', { key }) }, 'Reset');
    const element = make('div', { class: 'field' }, make('label', {}, make('span', {}, name)), body, reset);
    return { element, reset, fill: (current, changed) => {
      Object.assign(parameter, current);
      fill(current.value);
      reset.hidden = !changed;
      element.classList.toggle('set', changed);
    } };
  }

  function rebuild(force = false) {
    const wanted = filter.value.trim().toLowerCase();
    const visible = parameters.filter(({ key, plugin }) => `${key} ${plugin}`.toLowerCase().includes(wanted));
    const keys = visible.map(({ key }) => key).join('\n');
    if (!force && (keys === built || isTyping(list))) return;
    const open = new Set([...list.querySelectorAll('details[open]')].map((details) => details.dataset.name));
    built = keys;
    rows = new Map();
    list.replaceChildren();
    for (const [group, title] of Object.entries(GROUPS)) {
      const members = visible.filter((parameter) => parameter.group === group);
      if (!members.length) continue;
      const content = make('div');
      const elements = new Map();
      for (const parameter of members) {
        if (!elements.has(parameter.element)) {
          const inside = make('div');
          const name = `${group}/${parameter.element}`;
          content.append(make('details', { 'data-name': name, open: open.has(name) || (wanted !== '' && members.length < 12) },
            make('summary', {}, `${parameter.element} `, make('span', { class: 'soft' }, parameter.plugin)), inside));
          elements.set(parameter.element, inside);
        }
        const one = field({ ...parameter });
        rows.set(parameter.key, one);
        elements.get(parameter.element).append(one.element);
      }
      list.append(make('details', { 'data-name': group, open: open.has(group) || wanted !== '' }, make('summary', {}, `${title} (${elements.size})`), content));
    }
  }

  let own = { changes: {} };
  function fill() {
    for (const parameter of parameters) rows.get(parameter.key)?.fill(parameter, parameter.key in own.changes);
  }

  host.onState((state) => {
    if (!state.panels.parameters) return;
    own = state.panels.parameters;
    parameters = own.parameters;
    rebuild();
    fill();
    const changed = Object.entries(own.changes);
    note.textContent = parameters.length ? '' : 'There is nothing to edit in this scene.';
    note.hidden = parameters.length > 0;
    all.disabled = changed.length === 0;
    changes.replaceChildren(...(changed.length ? changed : [[null, null]]).map(([key, value]) => make('li', {},
      key === null ? make('span', { class: 'soft' }, 'none') : make('span', { style: 'overflow-wrap: anywhere' }, `${key.replace(/\.value$/, '')} = ${shown(value).slice(0, 60)}`))));
  });
}
