// Lights of the scene, and lights that are added.

export default function (host) {
  const { make, numeric, numerics: numbers } = host;
  const own = make('ul', { class: 'list' });
  const added = make('ul', { class: 'list' });
  const field = (label, value, attributes = {}) => {
    const input = make('input', { type: 'text', autocomplete: 'off', spellcheck: 'false', value, ...attributes });
    return { element: make('label', { class: 'grow' }, make('span', {}, label), input), input };
  };
  const kind = make('select', { change: () => shape() });
  const colour = make('input', { type: 'color', value: '#ffffff' });
  const strength = field('Strength', '1', { inputmode: 'decimal' });
  const position = field('Position', '');
  const target = field('Points at', '');
  const size = field('Side', '', { inputmode: 'decimal' });
  const file = field('Image file', '', { placeholder: 'sky.exr' });
  const texts = { point: 'point: a bulb without size', area: 'area: a bright square', sky: 'sky: light from everywhere', image: 'image: light from a picture around the scene' };

  function shape() {
    const is = (...kinds) => kinds.includes(kind.value);
    position.element.hidden = !is('point', 'area');
    target.element.hidden = size.element.hidden = !is('area');
    file.element.hidden = !is('image');
    colour.parentElement.hidden = is('image');
  }

  const linear = (hex) => [1, 3, 5].map((k) => {
    const c = parseInt(hex.slice(k, k + 2), 16) / 255;
    return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  });
  const add = make('button', { type: 'button', click: () => host.send('add', {
    kind: kind.value, colour: linear(colour.value), strength: numeric(strength.input.value),
    position: numbers(position.input.value), target: numbers(target.input.value), size: numeric(size.input.value), file: file.input.value }) }, 'Add the light');
  host.element.append(own, added, make('label', {}, make('span', {}, 'New light'), kind),
    make('div', { class: 'row' }, make('label', {}, make('span', {}, 'Colour'), colour), strength.element, size.element),
    position.element, target.element, file.element, make('p', { class: 'soft' }, 'Click into the picture to place it before what is seen there.'), make('div', {}, add));

  let placed = false;
  host.onPick((found) => {
    if (!found.position) return;
    // In front of the surface, by a tenth of its distance.
    position.input.value = found.position.map((v, k) => Number((v + found.normal[k] * found.depth * 0.1).toPrecision(4))).join(' ');
    target.input.value = found.position.map((v) => Number(v.toPrecision(4))).join(' ');
    placed = true;
  });
  host.onState((state) => {
    const { own: scene, added: others, kinds } = state.panels.lights;
    if (!kind.options.length) { kind.append(...kinds.map((name) => make('option', { value: name }, texts[name]))); shape(); }
    own.replaceChildren(...scene.map(({ name, index, off }) => make('li', {}, make('label', { class: 'check' },
      Object.assign(make('input', { type: 'checkbox', change: () => host.send('switch', { index }) }), { checked: !off }), make('span', {}, name)))));
    added.replaceChildren(...others.map(({ name, index }) => make('li', {}, `added: ${name}`,
      make('button', { type: 'button', click: () => host.send('remove', { index }) }, 'Remove'))));
    if (!placed && state.camera) {
      const between = (t) => state.camera.origin.map((v, k) => Number((v + t * (state.camera.target[k] - v)).toPrecision(4))).join(' ');
      if (!position.input.value) position.input.value = between(0.5);
      if (!target.input.value) target.input.value = between(1);
      if (!size.input.value) size.input.value = Number((state.camera.distance * 0.1).toPrecision(2));
    }
  });
}
