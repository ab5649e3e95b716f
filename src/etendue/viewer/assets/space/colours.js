// Numbers as colours on a logarithmic scale, and its legend. The map is that of display.false_colour ("inferno", CC0).

const STOPS = [[0, 0, 4], [31, 12, 72], [85, 15, 109], [136, 34, 106], [186, 54, 85], [227, 89, 51], [249, 140, 10], [249, 201, 50], [252, 255, 164]];

/** The colour of a place 0 to 1 on the scale. */
export function look(t) {
  if (!(t >= 0)) return [0, 200, 220];
  const place = Math.min(t, 1) * (STOPS.length - 1);
  const k = Math.min(Math.floor(place), STOPS.length - 2);
  return STOPS[k].map((v, c) => Math.round(v + (place - k) * (STOPS[k + 1][c] - v)));
}

/** The place of a value between low and high. */
export function shade(value, low, high) {
  if (Number.isNaN(value)) return NaN;
  return Math.log(Math.min(Math.max(value, low), high) / low) / Math.log(high / low);
}

/** Ends of a scale for values: nearly all of them, within four decades. */
export function span(values) {
  const positive = Float64Array.from(values).filter((v) => v > 0 && Number.isFinite(v)).sort();
  if (!positive.length) return [1e-6, 1];
  const high = positive[Math.floor(0.995 * (positive.length - 1))];
  const low = Math.max(positive[Math.floor(0.005 * (positive.length - 1))], high * 1e-4);
  return low < high * 0.999 ? [low, high] : [high * 0.5, high * 1.5];
}

export function legend(make, title, low, high, short) {
  const gradient = `linear-gradient(to right, ${STOPS.map((c) => `rgb(${c.join(' ')})`).join(', ')})`;
  return make('div', { class: 'scale', style: 'margin-top: .3rem' }, make('div', {}, title),
    make('div', { style: `width: 12rem; height: .6rem; background: ${gradient}` }),
    make('div', { style: 'width: 12rem; display: flex; justify-content: space-between' }, make('span', {}, short(low)), make('span', {}, short(high))));
}
