// Fields made from lists of settings, see controls.py, and small helpers to build elements.

/** An element with attributes (functions become listeners, null is left out) and children. */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === 'function') element.addEventListener(name, value);
    else if (value === true) element.setAttribute(name, '');
    else if (value !== null && value !== undefined && value !== false) element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

const typing = new WeakSet();
for (const name of ['input', 'change', 'focusout']) {
  document.addEventListener(name, (event) => { if (name === 'input') typing.add(event.target); else typing.delete(event.target); }, true);
}

/** Whether something is being typed in a field below an element, which the session does not know yet. */
export const isTyping = (element) => element.contains(document.activeElement) && typing.has(document.activeElement);

/** Show in a field what holds, unless something is being typed there. */
export function fillIn(input, value) {
  if (!isTyping(input)) input.value = value;
}

/** A number that was typed, or the text itself, which the session then refuses by name. */
export function numeric(text) {
  const number = Number(text);
  return text.trim() === '' || !Number.isFinite(number) ? text.trim() : number;
}

/** Numbers with spaces or commas between them. */
export const numerics = (text) => text.trim().split(/[\s,]+/).map(numeric);

/** A section of the side bar; returns the element for its content. */
export function section(parent, title, open = false) {
  const content = make('div');
  parent.append(make('details', { open, 'data-section': title }, make('summary', {}, title), content));
  return content;
}

/** A labelled select of [{name, about}] or of names. */
export function choice(label, options, value, change) {
  const select = make('select', { change: () => change(select.value) });
  fillChoice(select, options, value);
  return { element: make('label', {}, make('span', {}, label), select), select };
}

export function fillChoice(select, options, value) {
  const names = options.map((option) => option.name ?? option);
  if (select.dataset.names !== names.join(' ')) {
    select.dataset.names = names.join(' ');
    select.replaceChildren(...options.map((option) =>
      make('option', { value: option.name ?? option, title: option.about ?? null }, option.label ?? option.name ?? option)));
  }
  select.value = value;
}

/** A labelled text field that reports its value when it is left or Enter is pressed. */
export function entry(label, value, change, attributes = {}) {
  const input = make('input', { type: 'text', autocomplete: 'off', spellcheck: 'false', value, ...attributes,
    change: () => change(input.value) });
  return { element: make('label', { class: 'grow' }, make('span', {}, label), input), input };
}

/** The fields of a list of settings with their help; `change(name, value)` gets what was typed. */
export function controls(list, values, change) {
  return make('div', { class: 'fields' }, ...list.map((field) => {
    const value = values[field.name] ?? field.default;
    const id = `field-${field.name}-${Math.random().toString(36).slice(2, 8)}`;
    const label = field.name.replaceAll('_', ' ');
    const common = { id, 'aria-describedby': `${id}-help` };
    let body;
    if (field.kind === 'bool') {
      const box = make('input', { type: 'checkbox', ...common, change: () => change(field.name, box.checked) });
      box.checked = value;
      body = make('label', { class: 'check', for: id }, box, make('span', {}, label));
    } else {
      let input;
      if (field.kind === 'choice') {
        input = make('select', { ...common, change: () => change(field.name, input.value) },
          ...field.choices.map((name) => make('option', { value: name }, name)));
        input.value = value;
      } else {
        input = make('input', { ...common, type: 'text', autocomplete: 'off', spellcheck: 'false', value,
          inputmode: field.kind === 'text' ? 'text' : 'decimal', change: () => change(field.name, input.value) });
      }
      body = make('label', { for: id }, make('span', {}, label), input);
    }
    const isSet = values[field.name] !== undefined && values[field.name] !== field.default;
    return make('div', { class: isSet ? 'field set' : 'field' }, body,
      make('small', { id: `${id}-help` }, `${field.doc}${range(field)}; default ${format(field.default)}`));
  }));
}

function range(field) {
  const parts = [];
  if (field.minimum !== undefined) parts.push(`at least ${field.minimum}`);
  if (field.above !== undefined) parts.push(`above ${field.above}`);
  if (field.maximum !== undefined) parts.push(`at most ${field.maximum}`);
  return parts.length ? ` (${parts.join(', ')})` : '';
}

const format = (value) => (value === '' ? 'none' : value === true ? 'on' : value === false ? 'off' : String(value));

/** A number with three digits. */
export function short(value) {
  if (value === null || value === undefined) return '–';
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e6)) return value.toExponential(2);
  return String(Number(value.toPrecision(3)));
}

/** An error, as progress and results in Python write it: three digits, in exponent form below 1e-5 only. */
export function number(value) {
  return value === 0 || Math.abs(value) >= 1e-5 ? value.toPrecision(3) : value.toExponential(2);
}

export function seconds(value) {
  if (value < 60) return `${value.toFixed(1)} s`;
  const whole = Math.round(value);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, '0')} min`;
}

export function rate(value) {
  if (!value) return '';
  for (const [scale, prefix] of [[1e9, 'G'], [1e6, 'M'], [1e3, 'k']]) {
    if (value >= scale) return `${(value / scale).toPrecision(3)} ${prefix}rays/s`;
  }
  return `${value.toFixed(0)} rays/s`;
}
