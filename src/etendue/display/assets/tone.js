// From linear values to bytes of a display: exposure and tone curve, or false colours.
//
// A tone curve is encode(after f(before x)), f and encode as tables (display/curves.py): f at equal steps of log2 x
// between `range`, encode at squares of equal steps.

const at = (table, place) => {
  const i = Math.min(Math.max(Math.floor(place), 0), table.length - 2);
  return table[i] + Math.min(Math.max(place - i, 0), 1) * (table[i + 1] - table[i]);
};
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const BRIGHTEST = 1e30;

/** A function that writes the bytes of `source`, interleaved red, green and blue, into `target`, RGBA. */
export const toneMapper = (curve, [lowest, highest], stops) => {
  const { before, after } = curve, gain = 2 ** stops;
  const f = (x) => {
    if (x < 2 ** lowest) return (x / 2 ** lowest) * curve.f[0];
    return at(curve.f, (Math.log2(x) - lowest) * ((curve.f.length - 1) / (highest - lowest)));
  };
  const encode = (y) => Math.round(255 * at(curve.encode, Math.sqrt(clamp(y, 0, 1)) * (curve.encode.length - 1)));
  const expose = (x) => Math.min(x * gain, BRIGHTEST);
  if (before) {
    const mix = (row, r, g, b) => row[0] * r + row[1] * g + row[2] * b;
    return (source, target) => {
      for (let i = 0, k = 0; k < target.length; i += 3, k += 4) {
        const r = expose(source[i]), g = expose(source[i + 1]), b = expose(source[i + 2]);
        const [x, y, z] = before.map((row) => f(mix(row, r, g, b)));
        for (let c = 0; c < 3; c++) target[k + c] = encode(mix(after[c], x, y, z));
        target[k + 3] = 255;
      }
    };
  }
  // The upper half of a float is the index of its byte: exponent and 7 bits of mantissa, steps of at most 0.8 %.
  const table = new Uint8Array(32768), bits = new Uint32Array(1), float = new Float32Array(bits.buffer);
  for (let i = 0; i < table.length; i++) {
    bits[0] = (i << 16) | 0x8000; // the middle of the values that share an index
    table[i] = encode(f(expose(Number.isFinite(float[0]) ? float[0] : BRIGHTEST)));
  }
  table[0] = encode(f(0));
  return (source, target) => {
    const words = new Uint32Array(source.buffer, source.byteOffset, source.length);
    for (let i = 0, k = 0; k < target.length; i += 3, k += 4) {
      target[k] = table[words[i] >>> 16];
      target[k + 1] = table[words[i + 1] >>> 16];
      target[k + 2] = table[words[i + 2] >>> 16];
      target[k + 3] = 255;
    }
  };
};

/** The same for values from 0 to 1 that are to be shown as they are: `gamma` makes them sRGB. */
export const plainMapper = (gamma) => {
  const encode = (x) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
  return (source, target) => {
    for (let i = 0, k = 0; k < target.length; k += 4) {
      for (let c = 0; c < 3; c++, i++) {
        const x = clamp(source[i], 0, 1);
        target[k + c] = Math.round(255 * (gamma ? encode(x) : x));
      }
      target[k + 3] = 255;
    }
  };
};

/** False colours of one channel on a logarithmic scale; zero and less are black. */
export const falseColourMapper = (stops, [low, high]) => (source, target) => {
  const last = stops.length - 1, scale = last / Math.log(high / low);
  for (let i = 0, k = 0; k < target.length; i++, k += 4) {
    const place = clamp(Math.log(clamp(source[i], low, high) / low) * scale, 0, last);
    const a = stops[Math.min(Math.floor(place), last - 1)], b = stops[Math.min(Math.floor(place), last - 1) + 1];
    const share = place - Math.min(Math.floor(place), last - 1);
    for (let c = 0; c < 3; c++) target[k + c] = Math.round(a[c] + share * (b[c] - a[c]));
    target[k + 3] = 255;
  }
};

/** The number of a label in three bytes, -1 for none. */
export const labelOf = (source, i) => (source[3 * i] * 256 + source[3 * i + 1]) * 256 + source[3 * i + 2] - 1;

/** A colour for each number; none is grey. */
export const labelMapper = () => (source, target) => {
  for (let i = 0, k = 0; k < target.length; i++, k += 4) {
    const label = labelOf(source, i);
    let hash = Math.imul(label + 1, 0x9e3779b1);
    hash = Math.imul(hash ^ (hash >>> 15), 0x85ebca6b);
    for (let c = 0; c < 3; c++) target[k + c] = label < 0 ? 96 : 64 + ((hash >>> (8 * c)) & 127) + 32;
    target[k + 3] = 255;
  }
};
