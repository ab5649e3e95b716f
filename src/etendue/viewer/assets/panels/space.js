// The 3-D view and what is drawn in it: surfaces, the camera, paths, photons, trees, radiosity, the guide.

import { Drawing } from '../space/gl.js';
import { Orbit, add, cross, meet, unit } from '../space/orbit.js';
import { legend, look, shade, span } from '../space/colours.js';
import { rays } from '../space/rays.js';
import { boxEdges, frustum, sphereEdges, unpacked } from '../space/shapes.js';

/** Milliseconds within which an answer comes at once: the page does not tell what is being done for it. */
const AT_ONCE = 300;
const FACINGS = ['+x', '−x', '+y', '−y', '+z', '−z'];

export default function (host) {
  const { make, numeric, short } = host;
  let view = null; // the open 3-D view
  let state = null;
  const held = { mesh: null, photons: null, trees: null, solution: null, values: null };
  const cleared = new Set(); // of these, answers that come late are not shown

  // ---- controls

  const number = (label, value, attributes = {}) => {
    const input = make('input', { type: 'text', inputmode: 'decimal', autocomplete: 'off', value, ...attributes });
    return { element: make('label', { class: 'grow' }, make('span', {}, label), input), input };
  };
  const select = (label, options, change) => {
    const input = make('select', { change }, ...options.map(([value, text]) => make('option', { value }, text)));
    return { element: make('label', { class: 'grow' }, make('span', {}, label), input), input };
  };
  const button = (text, click) => make('button', { type: 'button', click }, text);
  const row = (...children) => make('div', { class: 'row' }, ...children);
  const details = (title, ...children) => make('details', {}, make('summary', {}, title), make('div', {}, ...children));

  const surfaces = select('Surfaces', [['2', 'flat with edges'], ['0', 'flat'], ['1', 'edges only'], ['4', 'hidden']], () => redraw());
  const backs = Object.assign(make('input', { type: 'checkbox', change: () => redraw() }), { checked: true });
  const open = button('Open the 3-D view', () => show());

  const paths = rays(host, () => redraw());

  const photons = number('Light paths', '5000');
  const dots = make('input', { type: 'range', min: 1, max: 12, step: 0.5, value: 4, 'aria-label': 'Size of points', input: () => redraw() });
  const file = number('or a file of particles', '', { inputmode: 'text', placeholder: 'hits.particles' });
  const photonsNote = make('p', { class: 'soft' });

  const tree = select('Tree or grid', [], () => { radius.element.hidden = tree.input.value !== 'hash-grid'; });
  const radius = number('Radius', '');
  radius.element.hidden = true;
  const level = make('input', { type: 'range', min: 0, max: 0, value: 0, 'aria-label': 'Level', input: () => redraw() });
  const levels = Object.assign(make('input', { type: 'checkbox', change: () => redraw() }), { checked: false });
  const treesNote = make('p', { class: 'soft' });

  const area = number('Largest area of a patch', '', { placeholder: 'a thousandth of all' });
  const solved = number('or a file of a solution', '', { inputmode: 'text', placeholder: 'solution.npz' });
  const quantity = select('Show', [['radiosity', 'radiosity'], ['error', 'standard error'], ['residual', 'residual']], () => redraw());
  const run = button('Solve', () => host.send(state?.panels.space.solving ? 'stop' : 'solve', { area: area.input.value.trim() === '' ? null : numeric(area.input.value), file: solved.input.value }));
  const solveNote = make('p', { class: 'soft' });
  const patch = make('p', { class: 'numbers', 'aria-live': 'polite' });

  const guideNote = make('p', { class: 'soft' }, 'Render by guided, and click a surface here or in the 3-D view: the directions that the guide of that cell samples.');
  const guidePicture = make('canvas', { width: 256, height: 128, hidden: true, style: 'width: 100%; image-rendering: pixelated', role: 'img', 'aria-label': 'Density of directions in the cell' });

  host.element.append(
    row(open), row(surfaces.element), make('label', { class: 'check' }, backs, make('span', {}, 'Hide backs, to look into rooms')),
    paths.section,
    details('Photons', row(photons.element, file.element), make('label', {}, make('span', {}, 'Size of points'), dots),
      row(button('Trace', () => ask('photons', 'photons', { count: numeric(photons.input.value), file: file.input.value })), button('Clear', () => clear('photons'))), photonsNote),
    details('Trees and grids', row(tree.element, radius.element), make('label', {}, make('span', {}, 'Level'), level),
      make('label', { class: 'check' }, levels, make('span', {}, 'All levels up to this one')),
      row(button('Show', () => ask('trees', 'tree', { kind: tree.input.value, count: numeric(photons.input.value), radius: radius.input.value.trim() === '' ? 0 : numeric(radius.input.value) })), button('Clear', () => clear('trees'))), treesNote),
    details('Radiosity', row(area.element, solved.element), row(run, quantity.element), row(button('Clear', () => { if (state?.panels.space.solving) host.send('stop'); held.values = null; solveNote.textContent = patch.textContent = ''; clear('solution'); })), solveNote, patch),
    details("Guide's directions", guideNote, guidePicture));

  function ask(name, verb, fields) {
    cleared.delete(name);
    host.send(verb, fields);
  }

  function clear(name) {
    if (name !== 'solution') cleared.add(name); // those of radiosity end when it is stopped
    held[name] = null;
    redraw();
  }

  // ---- messages

  host.onState((message) => {
    state = message;
    const own = message.panels.space;
    if (!own) return;
    paths.show(message);
    if (!tree.input.options.length) tree.input.append(...Object.entries(own.trees).map(([value, text]) => make('option', { value }, text)));
    run.textContent = own.solving ? 'Stop' : 'Solve';
    run.setAttribute('aria-pressed', own.solving);
    if (own.scene !== held.scene) {
      const first = held.scene === undefined;
      Object.assign(held, { scene: own.scene, mesh: null, photons: null, trees: null, solution: null, values: null });
      paths.clear();
      if (view && !first) { view.placed = false; host.send('mesh'); }
    }
    paths.overPicture(state.size);
  });
  host.onPick((found) => {
    paths.pick(found);
    if (state?.panels.space?.guided && found.point) host.send('guide', { position: found.point, normal: found.normal });
  });
  const notes = { paths: paths.note, photons: photonsNote, tree: treesNote, solve: solveNote, guide: guideNote };
  const waits = {};
  host.on('busy', ({ verb, text }) => {
    const note = notes[verb];
    if (!note) return;
    clearTimeout(waits[verb]);
    const told = text && `${text[0].toUpperCase()}${text.slice(1)} …`;
    if (text) waits[verb] = setTimeout(() => { note.textContent = told; }, AT_ONCE);
    else if (note.textContent.endsWith(' …')) note.textContent = ''; // no answer has replaced it
    note.ariaBusy = String(Boolean(text));
  });
  const take = (name, then) => host.on(name, (message, data) => { if (cleared.has(name)) return; held[name] = { ...message, ...unpacked(message.arrays, data) }; then(held[name]); redraw(); });
  take('mesh', (mesh) => { if (mesh.left_out) host.say(`${mesh.left_out} of the smallest triangles are not drawn`); if (mesh.missing.length) host.say(`Not drawn: ${mesh.missing.join(', ')}`); });
  host.on('paths', (message, data) => { paths.take({ ...message, ...unpacked(message.arrays, data) }); redraw(); });
  take('photons', (found) => { photonsNote.textContent = `${found.value.length} photons, ${short(found.total)} W in all.`; });
  take('trees', (found) => {
    const deepest = found.level.reduce((a, b) => Math.max(a, b), 0);
    level.max = deepest;
    level.value = Math.min(Number(level.value) || deepest, deepest);
    treesNote.textContent = `${found.level.length} ${found.centres ? 'spheres' : 'boxes'}, levels 0 to ${deepest}.`;
  });
  take('solution', () => { held.values = null; });
  take('values', (values) => {
    if (!held.solution) { // of a solution that was begun before this page was opened
      held.values = null;
      if (!held.asked && state?.panels.space.solving) { held.asked = true; host.send('mesh'); }
      return;
    }
    const parts = [`${held.solution.areas.length} patches`];
    if (values.bundles) parts.push(`${values.bundles} bundles of lines`);
    parts.push(values.relative === null ? 'error not known' : `error ${short(100 * values.relative)} %`);
    solveNote.textContent = `${parts.join(', ')}.${values.done && values.bundles ? ' No more lines are cast here; etendue radiosity has no such limit.' : ''}`;
  });
  host.on('guide', (message, data) => {
    const { density } = unpacked(message.arrays, data);
    const [low, high] = span(density);
    const context = guidePicture.getContext('2d');
    [guidePicture.width, guidePicture.height] = [message.width, message.height];
    const pixels = context.createImageData(message.width, message.height);
    density.forEach((value, k) => pixels.data.set([...look(shade(value, low, high)), 255], 4 * k));
    context.putImageData(pixels, 0, 0);
    guidePicture.hidden = false;
    guideNote.textContent = `Cell ${message.cell} of ${message.cells}, facing ${FACINGS[message.facing]}: +z above, azimuth from +x to the right, ${short(low)} to ${short(high)} per steradian.`;
  });

  // ---- the 3-D view

  function show() {
    if (view) return;
    const opened = host.canvas('3-D view');
    const { canvas } = opened;
    let drawing;
    try {
      drawing = new Drawing(canvas);
    } catch (error) {
      opened.close();
      host.say(error.message, 'error');
      return;
    }
    const box = make('div', { class: 'space-legend', style: 'position: absolute; left: .6rem; bottom: .5rem; pointer-events: none; font-size: .85rem; max-width: 70%; color: #eee; text-shadow: 0 0 3px #000' });
    canvas.parentElement.append(box);
    const orbit = new Orbit(canvas, () => schedule(), (x, y, pressed) => pointed(x, y, pressed));
    view = { canvas, drawing, orbit, box, placed: false, size: new ResizeObserver(() => schedule()) };
    view.size.observe(canvas);
    opened.onclose = () => { view.size.disconnect(); drawing.close(); view = null; };
    if (held.mesh) redraw();
    else host.send('mesh');
    canvas.focus();
  }

  let scheduled = false;
  function schedule() {
    if (scheduled || !view) return;
    scheduled = true;
    requestAnimationFrame(() => { scheduled = false; paint(); });
  }

  function paint() {
    if (!view || !view.placed) return;
    // A dark page in both schemes, on which the colours of light are seen.
    const ink = view.drawing.mode === 1 ? [0.75, 0.78, 0.8] : [0.1, 0.1, 0.12];
    view.drawing.draw(view.orbit.matrix(), view.orbit.eye, [0.07, 0.075, 0.08], ink);
    view.canvas.dataset.painted = Number(view.canvas.dataset.painted ?? 0) + 1;
  }

  /** Fill the drawing anew from what is held. */
  function redraw() {
    paths.overPicture(state?.size);
    if (!view || !held.mesh) return;
    const { drawing } = view;
    drawing.mode = Number(surfaces.input.value);
    drawing.culled = backs.checked;
    if (!view.placed) {
      view.placed = true;
      view.orbit.place({ ...held.mesh.camera, size: held.mesh.size });
      view.orbit.turn(-0.3, 0.2); // beside the camera, so that it is seen
      view.orbit.approach(-0.15);
    }
    const legends = [];
    drawSurfaces(legends);
    drawing.set('camera', 'lines', ...frustum(held.mesh.camera, held.mesh.size));
    paths.draw(drawing, legends);
    drawPhotons(legends);
    drawTrees(legends);
    view.box.replaceChildren(...legends);
    schedule();
  }

  function drawSurfaces(legends) {
    const { mesh, solution, values } = held;
    const { drawing } = view;
    if (solution && values) {
      const kind = quantity.input.value;
      const of = kind === 'radiosity' ? values.luminance : values[kind];
      // The scale is that of what is lit: lamps are much brighter.
      const [low, high] = span(solution.emits.every(Boolean) ? of : of.filter((_, p) => !solution.emits[p]));
      const colours = (patches) => {
        const result = new Uint8Array(patches.length * 12);
        patches.forEach((p, k) => {
          const colour = p < of.length ? look(shade(of[p], low, high)) : [60, 60, 60];
          for (let corner = 0; corner < 3; corner += 1) result.set([...colour, 255], 12 * k + 4 * corner);
        });
        return result;
      };
      drawing.shade = 0;
      if (view.shown !== solution) {
        drawing.set('surfaces', 'triangles', solution.triangles, colours(solution.front), colours(solution.back));
        view.shown = solution;
      } else drawing.recolour('surfaces', colours(solution.front), colours(solution.back));
      legends.push(legend(make, `${kind === 'error' ? 'standard error' : kind} in W/m²`, low, high, short));
      return;
    }
    drawing.shade = 1;
    if (view.shown === mesh) return;
    const colours = new Uint8Array(mesh.shape.length * 12);
    mesh.shape.forEach((s, k) => { for (let corner = 0; corner < 3; corner += 1) colours.set([...mesh.colours.slice(3 * s, 3 * s + 3), 255], 12 * k + 4 * corner); });
    drawing.set('surfaces', 'triangles', mesh.triangles, colours);
    view.shown = mesh;
  }

  function drawPhotons(legends) {
    const { photons: found } = held;
    const { drawing } = view;
    drawing.remove('photons');
    if (!found) return;
    const [low, high] = span(found.value);
    const colours = new Uint8Array(found.value.length * 4);
    found.value.forEach((value, k) => colours.set([...look(0.15 + 0.85 * shade(value, low, high)), 255], 4 * k));
    drawing.set('photons', 'points', found.points, colours, null, { size: Number(dots.value) });
    legends.push(legend(make, 'power of a photon in W', low, high, short));
  }

  function drawTrees(legends) {
    const { trees: found } = held;
    const { drawing } = view;
    drawing.remove('trees');
    if (!found) return;
    const chosen = [...found.level.keys()].filter((k) => (levels.checked ? found.level[k] <= Number(level.value) : found.level[k] === Number(level.value)));
    const deepest = Math.max(1, Number(level.max));
    const edges = chosen.map((k) => (found.centres ? sphereEdges(found.centres.slice(3 * k, 3 * k + 3), found.radii[k]) : boxEdges(found.corners.subarray(24 * k, 24 * k + 24))));
    const positions = new Float32Array(edges.reduce((sum, e) => sum + e.length, 0));
    const colours = new Uint8Array(positions.length / 3 * 4);
    let at = 0;
    edges.forEach((e, n) => {
      positions.set(e, at);
      const colour = [...look(0.3 + 0.6 * (found.level[chosen[n]] / deepest)), 220];
      for (let k = at / 3; k < (at + e.length) / 3; k += 1) colours.set(colour, 4 * k);
      at += e.length;
    });
    drawing.set('trees', 'lines', positions, colours);
    legends.push(make('div', {}, `${chosen.length} of ${found.level.length} ${found.centres ? 'spheres' : 'boxes'}, level ${level.value}`));
  }

  // ---- what is under the pointer

  /** A point in the scene's own coordinates. */
  const ofScene = (point) => point.map((v, k) => v / held.mesh.space.scale + held.mesh.space.centre[k]);

  let last = 0;
  function pointed(x, y, pressed) {
    if (!view?.placed) return;
    const now = performance.now();
    if (!pressed && (now - last < 60 || !(held.solution && held.values))) return;
    last = now;
    const { drawing, orbit } = view;
    const layer = drawing.layers.get('surfaces');
    const hit = layer ? drawing.pick(orbit.matrix(), orbit.eye, x, y) : -1;
    schedule();
    if (hit < 0) { if (pressed) host.say('Nothing there.'); return; }
    const triangle = [...layer.positions.subarray(9 * hit, 9 * hit + 9)];
    const ray = orbit.ray(x, y);
    let normal = unit(cross(add(triangle.slice(3, 6), triangle.slice(0, 3), -1), add(triangle.slice(6, 9), triangle.slice(0, 3), -1)));
    const behind = normal.reduce((sum, v, k) => sum + v * ray.direction[k], 0) > 0;
    if (behind) normal = normal.map((v) => -v);
    if (held.solution && held.values) tellPatch(hit, behind);
    else if (pressed) patch.textContent = '';
    if (!pressed) return;
    const point = add(ray.origin, ray.direction, meet(ray, triangle) ?? 0);
    if (!held.solution) host.say(`${held.mesh.names[held.mesh.shape[hit]]} at ${ofScene(point).map(short).join(' ')}`);
    if (state.panels.space.guided) host.send('guide', { position: point, normal });
  }

  function tellPatch(hit, behind) {
    const { solution, values } = held;
    const p = (behind ? solution.back : solution.front)[hit];
    if (p >= values.luminance.length) { patch.textContent = 'The back of a face, which has no patch.'; return; }
    const radiosity = [0, 1, 2].map((c) => short(values.radiosity[3 * p + c])).join(' ');
    patch.textContent = `Patch ${p} of ${solution.names[solution.shape[p]]}: area ${short(solution.areas[p])}, radiosity ${radiosity}, error ${short(values.error[p])}, residual ${short(values.residual[p])}`;
    patch.dataset.patch = p;
    const shown = make('div', { class: 'numbers' }, patch.textContent);
    view.box.querySelector('.numbers')?.remove();
    view.box.append(shown);
  }
}
