// The page: connects the parts. The session's state is the truth; controls show it and send what is asked for.

import { Connection } from './connection.js';
import { controls, fillIn, isTyping, make, number, numeric, numerics, rate, seconds, section, short } from './controls.js';
import { Plot } from './plot.js';
import { sections } from './sections.js';
import { Stage } from './stage.js';

const $ = (id) => document.getElementById(id);
const listeners = { state: [], pick: [] };
let about = {};
let state = null;
let camera = null;
let compared = null;

const connection = new Connection((status, why) => {
  const texts = { open: '', closed: 'The connection is lost; trying again…', ended: `The session has ended${why ? `: ${why}` : ''}. This page can be closed.` };
  wait(texts[status]);
  document.body.dataset.connection = status;
});

const stage = new Stage(connection, {
  // A picture may still be decoded when the connection has gone: what is said of that stays.
  drawn: () => { if (state?.loaded && document.body.dataset.connection === 'open') wait(''); },
  keys: {
    Home: () => connection.send('camera', { reset: true }),
    KeyV: () => connection.send('views', { save: true }),
    KeyN: () => connection.send('views', { show: 'next' }),
    Space: () => connection.send('render', { paused: !state?.paused }),
  },
});

function wait(text) {
  $('waiting').textContent = text;
  $('waiting').hidden = !text;
}

// ---- messages of the session

function say(text, kind = 'note', link = null) {
  const log = $('messages');
  const remove = () => { line.remove(); log.hidden = !log.children.length; };
  const line = make('p', { class: kind }, make('span', {}, text),
    link ? make('a', { href: `files/${encodeURIComponent(link)}`, download: link }, 'Download') : null,
    make('button', { type: 'button', 'aria-label': 'Remove this message', click: remove }, '×'));
  log.hidden = false;
  log.prepend(line);
  while (log.children.length > 30) log.lastChild.remove();
  if (kind === 'note') setTimeout(remove, link ? 60000 : 20000); // errors stay until they are removed
}

connection.on('error', ({ text }) => say(text, 'error'));
connection.on('note', ({ text }) => {
  say(text);
  if (text.startsWith('The session has ended')) connection.end();
});
connection.on('saved', ({ path, file }) => say(`Written: ${path}`, 'note', file));

// ---- state

const show = sections($('sections'), connection, section);
const plot = new Plot(section($('sections'), 'Convergence'));
let plotted = '';

connection.on('about', (message) => {
  about = message;
  addPanels(message.scripts);
});

connection.on('state', (message) => {
  state = { ...about, ...message };
  camera = message.camera;
  compared = message.compared;
  $('scene').textContent = message.scene;
  document.title = `${message.scene} – étendue`;
  document.body.classList.toggle('still', message.still);
  stage.resize(message.size);
  $('pause').setAttribute('aria-pressed', message.paused);
  $('pause').textContent = message.paused ? 'Go on' : 'Pause';
  wait(message.trouble || (message.loaded ? '' : 'Loading the scene…'));
  if (message.preparing && !message.paused && !message.trouble) $('progress').textContent = `${message.method} is prepared…`;
  const other = compared && (compared.method || compared.reference.split('/').at(-1));
  stage.compare(Boolean(compared));
  $('tag-a').hidden = $('tag-b').hidden = !compared;
  $('tag-a').textContent = message.method;
  $('tag-b').textContent = compared?.map ? `error: ${message.method} and ${other}` : other ?? '';
  show(state);
  for (const listener of listeners.state) listener(state);
  document.body.dataset.ready = message.loaded;
});

connection.on('camera', (message) => { camera = message; for (const listener of listeners.state) listener({ ...state, camera }); });

connection.on('progress', (message) => {
  const parts = [message.method, `${message.samples} spp`, seconds(message.seconds), rate(message.rays_per_second)];
  if (message.error !== null) parts.push(`error ${number(message.error)}`);
  if (message.other) parts.push(`${message.other.method} ${message.other.samples} spp`);
  if (message.relmse !== undefined && message.relmse !== null) parts.push(`relMSE ${number(message.relmse)}`);
  if (message.done) parts.push('done');
  $('progress').textContent = parts.filter(Boolean).join(' · ');
  document.body.dataset.passes = message.passes;
  const key = `${message.method}|${message.other?.method ?? compared?.reference ?? ''}`;
  if (key !== plotted || message.passes < (plot.passes ?? 0)) { plot.clear(); plotted = key; }
  plot.passes = message.passes;
  plot.add(`estimated error of ${message.method}`, message.seconds, message.error);
  if (message.other) plot.add(`estimated error of ${message.other.method}`, message.other.seconds, message.other.error);
  const between = message.relmse === undefined || message.relmse === null ? null : Math.sqrt(message.relmse);
  plot.add(compared?.reference ? 'error against the reference' : 'error between them', message.seconds, between);
  plot.draw();
});

// ---- what is seen at a place

const triple = (values) => values.map(short).join(' ');

connection.on('picked', (found) => {
  const parts = found.shape === null ? [state?.still ? '' : 'nothing there'] : [found.shape, found.material, found.emits ? 'emits light' : '',
    `at ${triple(found.position)}`, `depth ${short(found.depth)}`];
  if (found.radiance) parts.push(`radiance ${triple(found.radiance)}`);
  $('picked').textContent = parts.filter(Boolean).join(' · ');
  mark(found);
  for (const listener of listeners.pick) listener(found);
});

function mark({ x, y }) {
  const [width, height] = stage.size;
  let cross = $('cross');
  if (!cross) {
    cross = document.createElementNS('http://www.w3.org/2000/svg', 'path');
    cross.id = 'cross';
    cross.setAttribute('fill', 'none');
    $('overlay').append(cross);
  }
  const r = height / 40;
  cross.setAttribute('d', `M ${x * width - r} ${y * height} h ${2 * r} M ${x * width} ${y * height - r} v ${2 * r}`);
  cross.setAttribute('stroke', '#fff');
  cross.setAttribute('stroke-width', r / 7);
  cross.style.mixBlendMode = 'difference';
}

// ---- panels of the session: modules with a host of their own, see viewer/panels

const added = new Set();

function addPanels(scripts) {
  for (const [name, { title, script }] of Object.entries(scripts)) {
    if (added.has(name)) continue;
    added.add(name);
    const element = section($('sections'), title);
    import(`./panels/${script}`).then((module) => module.default(host(name, element))).catch((error) => say(`${title}: ${error}`, 'error'));
  }
}

function host(name, element) {
  const overlay = document.createElementNS('http://www.w3.org/2000/svg', 'g');
  $('overlay').append(overlay);
  return {
    element, overlay, controls, fillIn, isTyping, make, numeric, numerics, short,
    send: (verb, data) => connection.send(`${name}.${verb}`, data),
    ask: (type, data) => connection.send(type, data),
    on: (verb, listener) => connection.on(`${name}.${verb}`, listener),
    onState: (listener) => { listeners.state.push(listener); if (state) listener(state); },
    onPick: (listener) => listeners.pick.push(listener),
    project: (point) => project(camera?.matrix, point),
    canvas: (title) => large(title, 'canvas'),
    page: (title) => large(title, 'div'),
    say,
  };
}

function project(matrix, [x, y, z]) {
  if (!matrix) return null;
  const [px, py, , w] = matrix.map((row) => row[0] * x + row[1] * y + row[2] * z + row[3]);
  return w > 1e-9 ? [px / w, py / w] : null;
}

let closeLarge = null;

/** An element over the picture, with a button that closes it. */
function large(title, tag) {
  closeLarge?.();
  const content = make(tag, tag === 'canvas' ? { tabindex: 0, 'aria-label': title } : {});
  const close = () => { $('large').hidden = true; $('large').replaceChildren(); closeLarge = null; onClose?.(); $('stage').focus(); };
  let onClose = null;
  const button = make('button', { type: 'button', click: close }, 'Close');
  $('large').replaceChildren(make('div', { class: 'row' }, button), content);
  $('large').hidden = false;
  closeLarge = close;
  button.focus();
  return { [tag === 'canvas' ? 'canvas' : 'element']: content, close, set onclose(listener) { onClose = listener; } };
}

$('large').addEventListener('keydown', (event) => { if (event.key === 'Escape') closeLarge?.(); event.stopPropagation(); });

// ---- buttons of the page

$('pause').addEventListener('click', () => connection.send('render', { paused: !state?.paused }));
$('again').addEventListener('click', () => connection.send('render', { again: true }));
$('open').addEventListener('submit', (event) => {
  event.preventDefault();
  wait('Loading the scene…');
  connection.send('open', { scene: $('open-name').value });
});
