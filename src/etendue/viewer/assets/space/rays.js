// Rays: their controls, and how they are drawn over the picture and in the 3-D view.

import { legend, look, shade, span } from './colours.js';

/** By the number of a kind: name, colour, and whether it is shown at first. */
const KINDS = [
  ['camera paths', [110, 170, 255]], ['light paths', [255, 165, 60]], ['to light points', [250, 240, 190]],
  ['connections', [255, 90, 210]], ['merges', [110, 240, 120]], ['to the sensor', [70, 225, 235]],
];
const [CAMERA, LIGHT, , , MERGE] = KINDS.keys();
/** Edges of camera paths that leave a vertex in a direction of the guide. */
const GUIDED = ['in directions of the guide', [190, 110, 255]];
const BY_GUIDE = 8;
const EVENTS = {
  2: ['scattered', [96, 176, 255]], [BY_GUIDE]: ['scattered by the guide', GUIDED[1]], 3: ['mirror', [255, 214, 90]], 4: ['glass', [90, 230, 190]],
  5: ['passed', [200, 200, 200]], 6: ['ended', [150, 110, 220]], 7: ['left the scene', [120, 120, 120]],
};
/** What is drawn later covers what is drawn before. */
const ORDER = [LIGHT, CAMERA, 2, 3, 5, MERGE];
/** Most edges of a kind over the picture. */
const MOST = 1500;
const OF_METHOD = ['camera', 'of the method, at the place clicked'];

/** `changed`: called when something else is to be drawn. */
export function rays(host, changed) {
  const { make, numeric } = host;
  let found = null; // the answer that is shown
  let asked = false; // not after they were cleared: an answer that comes late is not shown
  let place = [0.5, 0.5];
  let names = '';
  let state = null;

  const field = (label, input) => make('label', { class: 'grow' }, make('span', {}, label), input);
  const box = (text, checked, change, colour) => {
    const input = Object.assign(make('input', { type: 'checkbox', change }), { checked });
    const swatch = colour ? [make('i', { style: `display: inline-block; width: 1em; border-top: 3px solid rgb(${colour.join(' ')})` })] : [];
    return { input, element: make('label', { class: 'check' }, input, ...swatch, make('span', {}, text)) };
  };
  const option = ([value, text]) => make('option', { value }, text);
  const source = make('select', { change: () => changed() }, option(OF_METHOD));
  const count = make('input', { type: 'text', inputmode: 'numeric', autocomplete: 'off', value: '100' });
  const longest = make('input', { type: 'text', inputmode: 'numeric', autocomplete: 'off', value: '8', change: () => changed() });
  const colouring = make('select', { change: () => changed() }, ...[['kind', 'kind'], ['throughput', 'throughput'], ['event', 'what happens at the end'], ['number', 'edge of the path']].map(option));
  const shown = KINDS.map(([name, colour]) => box(name, true, () => changed(), colour));
  const follow = box('Follow the place clicked, the camera and the method', true, () => (follow.input.checked ? trace() : host.send('stay')));
  const note = make('p', { class: 'soft', 'aria-live': 'polite' }, 'Click into the picture to choose a place.');
  const button = (text, click) => make('button', { type: 'button', click }, text);
  const row = (...children) => make('div', { class: 'row' }, ...children);
  const section = make('details', {
    toggle: () => {
      if (!section.open) host.send('stay');
      else if (follow.input.checked && state?.panels.space && state.loaded && !state.still) trace();
    },
  }, make('summary', {}, 'Paths'), make('div', {},
    row(field('Paths', source)), row(field('Number', count), field('Edges at most', longest)), follow.element,
    row(field('Colour', colouring)), make('div', { style: 'display: grid; grid-template-columns: 1fr 1fr; gap: .3rem' }, ...shown.map(({ element }) => element)),
    row(button('Trace', () => trace()), button('Clear', () => clear(true))), note));

  function trace() {
    const isFollowing = follow.input.checked && section.open && source.value === OF_METHOD[0];
    asked = true;
    host.send('paths', { source: source.value, x: place[0], y: place[1], count: numeric(count.value), follow: isFollowing });
  }

  function clear(stay = false) {
    found = null;
    host.overlay.replaceChildren();
    if (stay) {
      asked = false;
      host.send('stay');
    }
    changed();
  }

  function take(answer) {
    if (!asked) return;
    found = answer;
    const goesOn = (k) => k > 0 && found.kind[k - 1] === found.kind[k] && found.path[k - 1] === found.path[k];
    found.guided = found.kind.map((_, k) => goesOn(k) && found.event[k - 1] === BY_GUIDE);
    const guided = found.guided.reduce((sum, one) => sum + one, 0);
    const counts = KINDS.map((_, kind) => found.kind.reduce((sum, one) => sum + (one === kind), 0));
    const parts = KINDS.map(([name], kind) => (counts[kind] ? `${counts[kind]} ${name}` : '')).filter(Boolean);
    if (guided) parts[0] += ` (${guided} ${GUIDED[0]})`;
    const whose = found.shown && found.shown !== found.method ? ` of ${found.shown}, because those of ${found.method} do not belong to pixels` : found.method ? ` of ${found.method}` : '';
    note.textContent = `${found.count} paths${whose}. Edges: ${parts.join(', ') || 'none'}${found.dropped ? `; ${found.dropped} more` : ''}.`;
  }

  /** Functions of the number of an edge: whether it is drawn, and its colour. */
  function drawing() {
    const most = Number(longest.value) || Infinity;
    const spans = [CAMERA, LIGHT].map((kind) => span(found.value.filter((_, k) => found.kind[k] === kind)));
    const isShown = (k) => shown[found.kind[k]].input.checked && found.number[k] <= most;
    const colour = (k) => {
      const kind = found.kind[k];
      if (kind > LIGHT || colouring.value === 'kind') return found.guided[k] ? GUIDED[1] : KINDS[kind][1];
      if (colouring.value === 'event') return EVENTS[found.event[k]]?.[1] ?? [255, 255, 255];
      if (colouring.value === 'number') return look(Math.min(1, found.number[k] / 10));
      return look(0.25 + 0.75 * shade(found.value[k], ...spans[kind]));
    };
    return { isShown, colour, spans };
  }

  function overPicture(size) {
    if (!found) return;
    const { isShown, colour } = drawing();
    const width = (size?.[1] ?? 480) / 500;
    const drawn = KINDS.map(() => 0);
    const lines = ORDER.map(() => []);
    for (let k = 0; k < found.kind.length; k += 1) {
      const kind = found.kind[k];
      if (!isShown(k) || drawn[kind] >= MOST) continue;
      const ends = [0, 3].map((c) => host.project(found.edges.subarray(6 * k + c, 6 * k + c + 3)));
      if (!ends[0] || !ends[1]) continue;
      drawn[kind] += 1;
      const line = document.createElementNS('http://www.w3.org/2000/svg', 'path');
      const style = {
        d: `M ${ends[0].map((v) => v.toFixed(1))} L ${ends[1].map((v) => v.toFixed(1))}`, stroke: `rgb(${colour(k).join(' ')})`, fill: 'none',
        'stroke-linecap': 'round', 'stroke-width': kind === MERGE ? 3 * width : kind > LIGHT ? width / 2 : width, opacity: kind === CAMERA || kind === MERGE ? 0.7 : 0.4,
      };
      for (const [name, value] of Object.entries(style)) line.setAttribute(name, value);
      lines[ORDER.indexOf(kind)].push(line);
    }
    host.overlay.replaceChildren(...lines.flat());
  }

  /** Draw them in the 3-D view. */
  function draw(view, legends) {
    view.remove('rays');
    view.remove('merged');
    if (!found) return;
    const { isShown, colour, spans } = drawing();
    const chosen = [...found.kind.keys()].filter(isShown);
    const positions = new Float32Array(6 * chosen.length);
    const colours = new Uint8Array(8 * chosen.length);
    chosen.forEach((k, n) => {
      positions.set(found.edges.subarray(6 * k, 6 * k + 6), 6 * n);
      const own = [...colour(k), found.kind[k] === CAMERA || found.kind[k] === MERGE ? 220 : 120];
      colours.set([...own, ...own], 8 * n);
    });
    view.set('rays', 'lines', positions, colours);
    const merged = chosen.filter((k) => found.kind[k] === MERGE);
    view.set('merged', 'points', new Float32Array(merged.flatMap((k) => [...found.edges.subarray(6 * k + 3, 6 * k + 6)])),
      new Uint8Array(merged.flatMap(() => [...KINDS[MERGE][1], 255])), null, { size: 3 });
    const named = (entries) => make('div', {}, ...entries.map(([name, rgb]) => make('span', { style: 'margin-right: .8em' },
      make('i', { style: `display: inline-block; width: 1em; border-top: 3px solid rgb(${rgb.join(' ')}); vertical-align: middle; margin-right: .3em` }), name)));
    const there = new Set(chosen.map((k) => found.kind[k]));
    if (colouring.value === 'throughput') {
      if (there.has(CAMERA)) legends.push(legend(make, 'throughput of camera paths', ...spans[CAMERA], host.short));
      if (there.has(LIGHT)) legends.push(legend(make, 'throughput of light paths in W', ...spans[LIGHT], host.short));
    } else if (colouring.value === 'event') legends.push(named(Object.values(EVENTS)));
    const kinds = KINDS.filter((_, kind) => there.has(kind) && (kind > LIGHT || colouring.value === 'kind'));
    if (colouring.value === 'kind' && found.guided.includes(1)) kinds.push(GUIDED);
    legends.push(named(kinds));
  }

  return {
    section, note, take, clear, overPicture, draw,
    pick(spot) {
      place = [spot.x, spot.y];
      if (section.open && follow.input.checked && source.value === OF_METHOD[0]) trace();
      else note.textContent = `Through (${host.short(spot.x)}, ${host.short(spot.y)}) of the picture.`;
    },
    show(now) {
      state = now;
      const options = [OF_METHOD, ['lights', 'from all lights'], ...now.panels.space.lights.map((name, k) => [String(k), `from ${name}`])];
      if (names === options.join('|')) return;
      names = options.join('|');
      const before = source.value;
      source.replaceChildren(...options.map(option));
      source.value = options.some(([value]) => value === before) ? before : OF_METHOD[0];
    },
  };
}
