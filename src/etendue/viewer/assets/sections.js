// The sections of the side bar that every session has: method, display, comparison, camera and files.

import { legend } from './space/colours.js';
import { choice, controls, entry, fillChoice, fillIn, isTyping, make, numeric, numerics } from './controls.js';

const EVERY = ['max_depth', 'rr_depth', 'samples_per_pass', 'sampler', 'scrambling', 'reconstruction', 'aovs', 'components', 'cryptomatte', 'for_denoising'];

/** Build them; returns the function that shows a state. */
export function sections(parent, connection, section) {
  const shown = [method, display, comparison, camera, files].map((build) => build(parent, connection, section));
  return (state) => shown.forEach((show) => show(state));
}

const optional = (value) => (value.trim() === '' ? undefined : numeric(value));

// ---- method, settings, budget, size

function method(parent, connection, section) {
  const content = section(parent, 'Method', true);
  let state = null;
  const pick = choice('Method', [], '', (name) => connection.send('render', { method: name, settings: {} }));
  const about = make('p', { class: 'soft' });
  const own = make('div');
  const common = make('div');
  const set = (name, value) => connection.send('render', { method: state.method, settings: { ...state.settings, [name]: value } });
  const budget = {};
  const limits = () => Object.fromEntries(Object.entries(budget).map(([name, { input }]) => [name, optional(input.value)]).filter(([, v]) => v !== undefined));
  for (const [name, label] of [['seconds', 'Seconds'], ['spp', 'Samples'], ['error', 'Error']]) {
    budget[name] = entry(label, '', () => connection.send('render', { budget: limits() }), { inputmode: 'decimal', placeholder: 'no limit' });
  }
  const sides = ['Width', 'Height'].map((label) => entry(label, '', () => connection.send('render', {
    size: sides.map(({ input }) => numeric(input.value)) }), { inputmode: 'numeric' }));
  content.append(pick.element, about,
    make('details', {}, make('summary', {}, 'Settings of the method'), own),
    make('details', {}, make('summary', {}, 'Settings of all methods'), common),
    make('div', { class: 'row' }, ...Object.values(budget).map((field) => field.element)),
    make('div', { class: 'row' }, ...sides.map((field) => field.element)));
  let built = '';
  connection.on('error', () => { built = ''; }); // fields of what was refused show again what holds
  return (now) => {
    state = now;
    fillChoice(pick.select, state.methods, state.method);
    const chosen = state.methods.find(({ name }) => name === state.method);
    about.textContent = chosen?.about ?? '';
    const key = JSON.stringify([state.method, state.settings, state.scene_settings]);
    if (key !== built && chosen && !isTyping(own) && !isTyping(common)) {
      built = key;
      const focused = document.activeElement?.id?.match(/^field-(\w+)-/)?.[1];
      const values = { ...state.scene_settings, ...state.settings };
      if (!('samples_per_pass' in state.settings)) delete values.samples_per_pass; // which the viewer chooses
      const isCommon = ({ name }) => EVERY.includes(name);
      own.replaceChildren(controls(chosen.fields.filter((field) => !isCommon(field)), values, set));
      common.replaceChildren(controls(chosen.fields.filter(isCommon), values, set));
      if (focused) content.querySelector(`[id^="field-${focused}-"]`)?.focus();
    }
    for (const [name, { input }] of Object.entries(budget)) fillIn(input, state.budget[name] ?? '');
    sides.forEach(({ input }, k) => fillIn(input, state.film?.[k] ?? ''));
  };
}

// ---- layer, denoiser, exposure, tone

function display(parent, connection, section) {
  const content = section(parent, 'Display', true);
  const send = (change) => connection.send('show', change);
  const layer = choice('Layer', [], 'image', (name) => send({ layer: name }));
  let filters = {};
  // As `etendue develop --denoise` reads it: the filter of all components, and those of single ones.
  const written = (changed) => Object.entries({ ...filters, ...changed }).filter(([, one]) => one).map(([component, one]) => (
    component ? `${component}=${one.name}${one.name === 'none' ? '' : `:radius=${one.radius}:strength=${one.strength}`}` : one.name)).join(',');
  const denoise = choice('Denoiser', [], '', (name) => send({ denoise: written({ '': name ? { name } : null }) }));
  const single = make('details', {}, make('summary', {}, 'Denoiser of each component'));
  const hint = make('p', { class: 'soft' }, 'Denoisers need the setting “for denoising” of all methods.');
  const radius = entry('Radius', '', (value) => send({ radius: numeric(value) }), { inputmode: 'numeric' });
  const strength = entry('Strength', '', (value) => send({ strength: numeric(value) }), { inputmode: 'decimal' });
  const curve = choice('Tone curve', [], 'srgb', (name) => send({ curve: name }));
  const automatic = make('input', { type: 'checkbox', change: () => send({ exposure: automatic.checked ? 'auto' : stops }) });
  const output = make('output', {}, '0.0');
  const exposure = make('input', { type: 'range', min: -10, max: 10, step: 0.25, 'aria-label': 'Exposure in stops',
    input: () => send({ exposure: Number(exposure.value) }) });
  let stops = 0;
  // Of the luminance in false colours, whose scale follows the exposure.
  const scale = make('div', { hidden: true });
  let ends = [1, 1];
  const showScale = (exposed) => scale.replaceChildren(
    legend(make, 'Luminance in cd/m²', ends[0] * 2 ** -exposed, ends[1] * 2 ** -exposed, (v) => String(Number(v.toPrecision(2)))));
  connection.on('progress', (message) => {
    showScale(message.exposure);
    if (!automatic.checked) return;
    stops = Math.round(message.exposure * 4) / 4;
    exposure.value = stops;
    output.textContent = message.exposure.toFixed(2);
  });
  content.append(layer.element, scale, denoise.element, make('div', { class: 'row' }, radius.element, strength.element), hint, single, curve.element,
    make('div', {}, make('div', { class: 'row' }, make('span', { class: 'grow soft' }, 'Exposure ', output, ' stops'),
      make('label', { class: 'check' }, automatic, make('span', {}, 'automatic'))), exposure));
  const row = (component) => {
    const change = (values) => send({ denoise: written({ [component]: values.name === '' ? null : { ...own(), ...values } }) });
    const pick = choice(component, [], '', (name) => change({ name }));
    const size = entry('Radius', '', (value) => change({ radius: numeric(value) }), { inputmode: 'numeric' });
    const much = entry('Strength', '', (value) => change({ strength: numeric(value) }), { inputmode: 'decimal' });
    let now = {};
    const own = () => filters[component] ?? { name: 'none', radius: now.radius, strength: now.strength };
    const options = make('div', { class: 'row' }, size.element, much.element);
    return { element: make('div', {}, pick.element, options), show: (show, denoisers) => {
      now = show;
      fillChoice(pick.select, [{ name: '', label: 'as above' }, { name: 'none' }, ...denoisers], filters[component]?.name ?? '');
      options.hidden = !filters[component] || filters[component].name === 'none';
      fillIn(size.input, own().radius);
      fillIn(much.input, own().strength);
    } };
  };
  let rows = [];
  let built = '';
  return ({ show, layers, components, curves, denoisers, luminance, ...state }) => {
    filters = state.filters;
    ends = luminance.ends;
    scale.hidden = show.layer !== luminance.layer;
    const every = [...new Set([...components, ...Object.keys(filters).filter((name) => name)])];
    if (built !== every.join(' ')) {
      built = every.join(' ');
      rows = every.map(row);
      single.replaceChildren(single.firstChild, ...rows.map(({ element }) => element));
    }
    rows.forEach((one) => one.show(show, denoisers));
    single.hidden = !every.length;
    hint.hidden = !show.denoise || layers.includes('variance');
    fillChoice(layer.select, layers.map((name) => ({ name, label: name === 'image' ? 'picture' : name })), show.layer);
    fillChoice(denoise.select, [{ name: '', label: 'none' }, ...denoisers], filters['']?.name ?? '');
    radius.element.hidden = strength.element.hidden = !filters[''];
    fillIn(radius.input, show.radius);
    fillIn(strength.input, show.strength);
    fillChoice(curve.select, curves, show.curve);
    automatic.checked = show.exposure === 'auto';
    if (show.exposure !== 'auto') {
      stops = show.exposure;
      showScale(stops);
      fillIn(exposure, stops);
      output.textContent = Number(stops).toFixed(2);
    }
  };
}

// ---- a second method, or a reference

function comparison(parent, connection, section) {
  const content = section(parent, 'Compare');
  const other = choice('Second method', [], '', (name) => connection.send('compare', name ? { method: name, settings: {} } : {}));
  const reference = entry('Reference picture', '', () => {}, { placeholder: 'reference.exr' });
  const use = () => connection.send('compare', reference.input.value.trim() ? { reference: reference.input.value.trim() } : {});
  const map = make('input', { type: 'checkbox', change: () => connection.send('compare', { ...current(), map: map.checked }) });
  let compared = null;
  const current = () => (compared?.reference ? { reference: compared.reference } : { method: compared?.method, settings: compared?.settings });
  const stop = make('button', { type: 'button', click: () => connection.send('compare', {}) }, 'Stop comparing');
  content.append(other.element, make('div', { class: 'row' }, reference.element, make('button', { type: 'button', click: use }, 'Compare')),
    make('label', { class: 'check' }, map, make('span', {}, 'show where they differ')), make('div', {}, stop));
  return (state) => {
    compared = state.compared;
    fillChoice(other.select, [{ name: '', label: 'none' }, ...state.methods], compared?.method ?? '');
    if (compared?.reference) fillIn(reference.input, compared.reference);
    map.checked = compared?.map ?? false;
    map.disabled = stop.disabled = !compared;
  };
}

// ---- camera and views

function camera(parent, connection, section) {
  const content = section(parent, 'Camera');
  const triple = (label, name) => entry(label, '', (value) => connection.send('camera', { set: { [name]: numerics(value) } }));
  const fields = { origin: triple('Position', 'origin'), target: triple('Target', 'target'), up: triple('Up', 'up') };
  const fov = entry('Field of view, horizontal, degrees', '', (value) => connection.send('camera', { set: { fov: numeric(value) } }), { inputmode: 'decimal' });
  const button = (text, type, message) => make('button', { type: 'button', click: () => connection.send(type, message) }, text);
  const views = make('ul', { class: 'list' });
  content.append(...Object.values(fields).map((field) => field.element), fov.element,
    make('div', { class: 'row' }, button("Scene's camera", 'camera', { reset: true }), button('Save view', 'views', { save: true }),
      button('Next view', 'views', { show: 'next' })), views);
  const show = (now) => {
    if (!now) return;
    for (const [name, { input }] of Object.entries(fields)) {
      fillIn(input, now[name].map((v) => Number(v.toPrecision(5))).join(' '));
    }
    fov.element.hidden = now.fov === null;
    if (now.fov !== null) fillIn(fov.input, Number(now.fov.toPrecision(4)));
  };
  connection.on('camera', show);
  return (state) => {
    show(state.camera);
    views.replaceChildren(...Array.from({ length: state.views }, (_, k) => make('li', {}, `View ${k + 1}`,
      make('span', { class: 'row' }, button('Show', 'views', { show: k }), button('Remove', 'views', { remove: k })))));
  };
}

// ---- files

function files(parent, connection, section) {
  const content = section(parent, 'Save');
  const row = (label, what, name) => {
    const field = entry(label, name, () => {});
    return make('div', { class: 'row' }, field.element, make('button', { type: 'button',
      click: () => connection.send('save', { what, name: field.input.value, ...(what === 'run' && { times: times.input.value }) }) }, 'Save'));
  };
  const times = entry('It saves pictures at these seconds, and ends with the last: 20, 60', '', () => {});
  const folder = make('p', { class: 'soft' });
  content.append(row('Picture: .exr with all layers, .png as shown', 'picture', 'view.png'), row('Scene with this camera: .xml', 'scene', 'view.xml'),
    row('Run file, which etendue run repeats: .toml', 'run', 'view.toml'), times.element, folder,
    make('div', {}, make('button', { type: 'button', click: () => { if (confirm('End the session for all pages?')) connection.send('quit'); } }, 'End the session')));
  return (state) => { folder.textContent = `Files are written to ${state.folder}.`; };
}
