// Lines of boxes, spheres and cameras, and the arrays of a message.

import { add, cross, unit } from './orbit.js';

const TYPES = { float32: Float32Array, uint32: Uint32Array, uint8: Uint8Array, int8: Int8Array };

/** Arrays by name from the table of a message and its data. */
export function unpacked(table, data) {
  return Object.fromEntries(table.map(({ name, type, shape, offset }) => {
    const count = shape.reduce((a, b) => a * b, 1);
    const start = data.byteOffset + offset;
    const size = TYPES[type].BYTES_PER_ELEMENT;
    return [name, new TYPES[type](data.buffer.slice(start, start + count * size))];
  }));
}

/** The twelve edges of a box, whose corner k has the upper end of the axes with a bit in k. */
export function boxEdges(corners) {
  const result = new Float32Array(72);
  let at = 0;
  for (let k = 0; k < 8; k += 1) {
    for (const bit of [1, 2, 4]) {
      if (k & bit) continue;
      result.set(corners.subarray(3 * k, 3 * k + 3), at);
      result.set(corners.subarray(3 * (k | bit), 3 * (k | bit) + 3), at + 3);
      at += 6;
    }
  }
  return result;
}

/** Three circles. */
export function sphereEdges(centre, radius, sides = 48) {
  const result = [];
  const point = (axis, k) => {
    const angle = (2 * Math.PI * k) / sides;
    const p = [...centre];
    p[(axis + 1) % 3] += radius * Math.cos(angle);
    p[(axis + 2) % 3] += radius * Math.sin(angle);
    return p;
  };
  for (let axis = 0; axis < 3; axis += 1) for (let k = 0; k < sides; k += 1) result.push(...point(axis, k), ...point(axis, k + 1));
  return new Float32Array(result);
}

/** The pyramid of a camera {origin, target, up, fov (horizontal, degrees), aspect}: positions and colours of lines. */
export function frustum({ origin, target, up, fov, aspect }, size) {
  const ahead = unit(add(target, origin, -1));
  const right = unit(cross(ahead, up));
  const above = cross(right, ahead);
  const length = 0.15 * size;
  const half = length * Math.tan(((fov ?? 40) * Math.PI) / 360);
  const corner = (x, y) => add(add(add(origin, ahead, length), right, x * half), above, (y * half) / aspect);
  const corners = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
  const tip = add(add(add(origin, ahead, length), above, (1.5 * half) / aspect), right, 0);
  const lines = [];
  corners.forEach((c, k) => lines.push(...origin, ...c, ...c, ...corners[(k + 1) % 4]));
  lines.push(...corners[2], ...tip, ...tip, ...corners[3]);
  const positions = new Float32Array(lines);
  return [positions, new Uint8Array((positions.length / 3) * 4).map((_, k) => [255, 60, 60, 255][k % 4])];
}
