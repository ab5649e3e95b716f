// The convergence plot: errors over time, on logarithmic axes.

const NS = 'http://www.w3.org/2000/svg';
const [WIDTH, HEIGHT, LEFT, BOTTOM, TOP, RIGHT] = [320, 190, 44, 30, 8, 8];
const MOST = 400;

function svg(tag, attributes, text) {
  const element = document.createElementNS(NS, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

export class Plot {
  constructor(element) {
    this.series = new Map();
    this.svg = svg('svg', { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: 'plot', role: 'img', 'aria-label': 'Noise over time' });
    this.legend = document.createElement('div');
    this.legend.className = 'legend';
    element.append(this.svg, this.legend);
  }

  clear() {
    this.series.clear();
    this.draw();
  }

  add(name, x, y) {
    if (!(x > 0) || !(y > 0)) return;
    const points = this.series.get(name) ?? [];
    if (points.length && points.at(-1)[0] >= x) return;
    points.push([x, y]);
    if (points.length > MOST) this.series.set(name, points.filter((_, k) => k % 2 === 0 || k > MOST - 20));
    else this.series.set(name, points);
  }

  draw() {
    const all = [...this.series.values()].flat();
    this.svg.replaceChildren();
    this.legend.replaceChildren();
    if (all.length < 2) {
      this.svg.append(svg('text', { x: WIDTH / 2, y: HEIGHT / 2, 'text-anchor': 'middle' }, 'after a few passes'));
      return;
    }
    const [xs, ys] = [0, 1].map((axis) => range(all.map((point) => Math.log10(point[axis]))));
    const place = ([x, y]) => [
      LEFT + ((Math.log10(x) - xs[0]) / (xs[1] - xs[0])) * (WIDTH - LEFT - RIGHT),
      HEIGHT - BOTTOM - ((Math.log10(y) - ys[0]) / (ys[1] - ys[0])) * (HEIGHT - BOTTOM - TOP),
    ];
    this.axis(xs, (value) => place([value, 10 ** ys[0]]), true);
    this.axis(ys, (value) => place([10 ** xs[0], value]), false);
    let number = 0;
    for (const [name, points] of this.series) {
      const colour = `var(--series-${(number++ % 4) + 1})`;
      const path = points.map((point) => place(point).map((v) => v.toFixed(1)).join(' ')).join(' L ');
      this.svg.append(svg('path', { d: `M ${path}`, fill: 'none', stroke: colour, 'stroke-width': 2, 'stroke-linejoin': 'round' }));
      const item = document.createElement('span');
      const line = document.createElement('i');
      line.style.borderColor = colour;
      item.append(line, name);
      this.legend.append(item);
    }
  }

  axis([low, high], place, isX) {
    const step = high - low > 3.5 ? 2 : 1;
    const ticks = [];
    for (let power = Math.ceil(low); power <= high + 1e-9; power += step) ticks.push(10 ** power);
    if (ticks.length < 2) {
      for (let power = Math.floor(low); power <= high; power++) for (const m of [2, 5]) {
        const value = m * 10 ** power;
        if (Math.log10(value) >= low && Math.log10(value) <= high) ticks.push(value);
      }
    }
    for (const value of ticks) {
      const [x, y] = place(value);
      const ends = isX ? { x1: x, x2: x, y1: TOP, y2: HEIGHT - BOTTOM } : { x1: LEFT, x2: WIDTH - RIGHT, y1: y, y2: y };
      this.svg.append(svg('line', { ...ends, stroke: 'var(--rule)' }));
      const label = value >= 0.01 && value < 1e4 ? String(Number(value.toPrecision(2))) : value.toExponential(0).replace('e', '·10^').replace('1·', '');
      this.svg.append(isX
        ? svg('text', { x, y: HEIGHT - BOTTOM + 13, 'text-anchor': 'middle' }, label)
        : svg('text', { x: LEFT - 4, y: y + 4, 'text-anchor': 'end' }, label));
    }
    if (isX) this.svg.append(svg('text', { x: WIDTH - RIGHT, y: HEIGHT - 3, 'text-anchor': 'end' }, 'seconds'));
  }
}

function range(values) {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const pad = Math.max(0.04 * (high - low), 0.05);
  return [low - pad, high + pad];
}
