// A viewer of pictures of one size: slider or flip between two, layers, exposure and tone curve, zoom, values of pixels.
//
// `root` holds the controls of pictures.html. `data` is that of display/report/stacks.py; a layer has its values in
// `planes` (see float.js) or, from elsewhere, in `values`, a Float32Array.

import { unpack } from "etendue/float.js";
import { falseColourMapper, labelMapper, labelOf, plainMapper, toneMapper } from "etendue/tone.js";

const ERROR = "error", OFFSET = 0.01; // that of relMSE
const digits = (x) => (x === 0 ? "0" : Math.abs(x) < 1e-4 || Math.abs(x) >= 1e6 ? x.toExponential(2) : String(Number(x.toPrecision(3))));
const inUnit = (text, layer) => (layer.unit ? `${text} ${layer.unit}` : text);

/** Mean over channels of (x - reference)^2 / (reference^2 + 0.01). */
const squaredError = (values, reference) => {
  const errors = new Float32Array(values.length / 3);
  for (let i = 0; i < errors.length; i++) {
    let sum = 0;
    for (let c = 3 * i; c < 3 * i + 3; c++) sum += (values[c] - reference[c]) ** 2 / (reference[c] ** 2 + OFFSET);
    errors[i] = sum / 3;
  }
  return errors;
};

const makeCanvas = (label) => {
  const canvas = document.createElement("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", label);
  return canvas;
};

/** Fill the controls and show the pictures. `thumbnails`: images of the page that follow exposure and curve, by number
 * of the picture. */
export const pictureViewer = async (root, data, thumbnails = []) => {
  const { width, height, pictures, reference } = data, names = pictures.map((p) => p.name);
  const part = (name) => root.querySelector(`[data-part="${name}"]`);
  const pair = data.pair ?? names.length > 1;
  const hasReference = reference !== null && reference !== undefined;

  // ---------------------------------------------------------------- layers

  const valuesOf = (layer) => (layer.values ??= unpack(layer));
  /** The layer of a picture with that name, or the picture itself. */
  const layerOf = (picture, name) => pictures[picture].layers.find((l) => l.name === name) ?? pictures[picture].layers[0];
  const errorLayer = (picture) => (pictures[picture].error ??= {
    name: ERROR, kind: ERROR, channels: 1, range: data.errors, ...size(pictures[picture].layers[0]),
    values: Promise.all([valuesOf(pictures[picture].layers[0]), valuesOf(pictures[reference].layers[0])])
      .then(([x, r]) => squaredError(x, r)),
  });
  const size = ({ width: w, height: h, block }) => ({ width: w, height: h, block });
  const chosenLayer = (picture) => {
    const name = controls.layer.value;
    return name === ERROR && hasReference && picture !== reference ? errorLayer(picture) : layerOf(picture, name);
  };

  // ---------------------------------------------------------------- development

  let mappers = {};
  const mapperOf = (layer) => {
    if (layer.kind === "radiance") return (mappers.radiance ??= toneMapper(data.curves[controls.curve.value], data.range, stops()));
    if (layer.kind === "albedo") return plainMapper(true);
    if (layer.kind === "direction") return plainMapper(false);
    if (layer.kind === "label") return labelMapper();
    return falseColourMapper(data.colours, layer.range);
  };
  const stops = () => data.exposure + Number(controls.exposure.value);
  const draw = async (canvas, layer) => {
    const values = await valuesOf(layer), bytes = new ImageData(layer.width, layer.height);
    mapperOf(layer)(values, bytes.data);
    canvas.width = layer.width;
    canvas.height = layer.height;
    canvas.getContext("2d").putImageData(bytes, 0, 0);
  };

  // ---------------------------------------------------------------- controls

  const controls = Object.fromEntries(
    ["left", "right", "layer", "exposure", "curve", "zoom", "position", "divide", "flip"].map((name) => [name, part(name)]),
  );
  const stage = part("stage"), frame = part("window"), divider = part("divider"), probe = part("probe");
  const back = makeCanvas("picture on the right"), front = makeCanvas("picture on the left");
  stage.prepend(back, front);
  stage.style.aspectRatio = `${width} / ${height}`;
  const state = { flipping: false, shown: 0, divided: 50, pixel: null };

  for (const [index, name] of names.entries()) {
    controls.left.add(new Option(name, index, false, index === data.left));
    controls.right.add(new Option(name, index, false, index === data.right));
  }
  const layerNames = [...new Set(pictures.flatMap((p) => p.layers.map((l) => l.name)))];
  if (hasReference && names.length > 1) layerNames.push(ERROR);
  for (const name of layerNames) controls.layer.add(new Option(name));
  controls.curve.value = data.curve;
  root.classList.toggle("single", !pair);
  if (!pair) part("left-name").textContent = "View";
  controls.left.parentElement.hidden = names.length < 2;
  root.querySelector(".layers").hidden = layerNames.length < 2;
  const note = [];
  const blocks = new Set(pictures.map((p) => p.layers[0].block)), most = Math.max(...blocks);
  const lower = pictures.some((p) => p.layers.some((l) => l.block > most));
  if (most > 1) note.push(`To keep this page small, a pixel here is the mean of ${most} × ${most} of the picture.`);
  if (lower) note.push("Layers have fewer pixels than pictures.");
  if (data.missing.length) note.push(`Left out: ${data.missing.join(", ")}; they are in the EXR files.`);
  part("resolution").textContent = note.join(" ");
  part("resolution").hidden = note.length === 0;

  /** The pictures that flipping goes through: left, right, and the reference if it is neither. */
  const round = () => {
    const all = [Number(controls.left.value), Number(controls.right.value), ...(hasReference ? [reference] : [])];
    return [...new Set(all)];
  };
  const label = (picture) => {
    const layer = chosenLayer(picture);
    return layer === pictures[picture].layers[0] ? names[picture] : `${names[picture]} · ${layer.name}`;
  };
  /** The part of the stage that is in view, across. */
  const inView = () => {
    const box = stage.getBoundingClientRect(), view = frame.getBoundingClientRect();
    const left = Math.max(box.left, view.left), right = Math.min(box.right, view.left + frame.clientWidth);
    return { box, left, width: Math.max(right - left, 1) };
  };
  const arrange = () => {
    // The divider is at a share of what is in view, also while a magnified picture is scrolled.
    const { box, left, width: across } = inView();
    const place = (100 * (left + (state.divided / 100) * across - box.left)) / Math.max(box.width, 1);
    const share = state.flipping || !pair ? 100 : place;
    front.style.clipPath = `inset(0 ${(100 - share).toFixed(2)}% 0 0)`;
    divider.style.left = `${share.toFixed(2)}%`;
    divider.hidden = state.flipping;
    part("position-row").hidden = state.flipping;
    controls.divide.setAttribute("aria-pressed", String(!state.flipping));
    controls.flip.setAttribute("aria-pressed", String(state.flipping));
    stage.classList.toggle("flipping", state.flipping);
    stage.classList.toggle("zoomed", Number(controls.zoom.value) > 0);
  };
  /** Which pictures are at the front and at the back. */
  const sides = () => {
    if (!pair) return [Number(controls.left.value), Number(controls.left.value)];
    if (!state.flipping) return [Number(controls.left.value), Number(controls.right.value)];
    const all = round(), shown = all[state.shown % all.length];
    return [shown, shown];
  };
  let drawn = 0;
  const show = async () => {
    const turn = ++drawn, [a, b] = sides(), layers = [chosenLayer(a), chosenLayer(b)];
    await Promise.all(layers.map(valuesOf));
    if (turn !== drawn) return; // a later call draws
    await Promise.all([draw(front, layers[0]), draw(back, layers[1])]);
    front.setAttribute("aria-label", label(a));
    back.setAttribute("aria-label", label(b));
    part("left-tag").textContent = label(a);
    part("right-tag").textContent = state.flipping || !pair ? "" : label(b);
    controls.flip.textContent = state.flipping ? `Flip: ${names[a]}` : "Flip";
    const scalar = layers.find((l) => l.range), scale = part("scale");
    scale.hidden = !scalar;
    if (scalar) {
      scale.firstElementChild.style.background = `linear-gradient(to right, ${data.colours.map((c) => `rgb(${c.join(" ")})`).join(", ")})`;
      scale.querySelectorAll("span").forEach((span, i) => { span.textContent = inUnit(digits(scalar.range[i]), scalar); });
    }
    const toned = layers.some((l) => l.kind === "radiance");
    root.querySelectorAll(".tone").forEach((control) => control.classList.toggle("idle", !toned));
    arrange();
    await tell();
  };
  const redevelop = async () => {
    const value = Number(controls.exposure.value);
    part("exposure-value").textContent = `${value > 0 ? "+" : ""}${value.toFixed(2)}`;
    mappers = {};
    await show();
    await Promise.all(thumbnails.map((canvas, i) => canvas && draw(canvas, pictures[i].layers[0])));
  };
  let waiting = false;
  /** At most once a frame, however fast a slider moves. */
  const redevelopSoon = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; redevelop(); });
  };

  // ---------------------------------------------------------------- zoom and values

  const resize = (around = null) => {
    // "fit" never shows a picture more than twice its size, small ones apart; the others are whole pixels of the screen.
    const factor = Number(controls.zoom.value), box = stage.getBoundingClientRect(), view = frame.getBoundingClientRect();
    const point = around ?? { x: view.left + view.width / 2, y: view.top + view.height / 2 };
    const share = { x: (point.x - box.left) / box.width, y: (point.y - box.top) / box.height };
    const largest = Math.max(2 * width, Math.min(480, 16 * width));
    stage.style.width = factor ? `${factor * width}px` : `min(100%, ${largest}px, ${(76 * width) / height}vh)`;
    const after = stage.getBoundingClientRect();
    stage.classList.toggle("pixels", after.width > 1.5 * width);
    frame.scrollLeft += after.left + share.x * after.width - point.x;
    frame.scrollTop += after.top + share.y * after.height - point.y;
    arrange();
    mark();
  };
  const zoomBy = (step, around) => {
    const { options, selectedIndex } = controls.zoom;
    const next = Math.min(Math.max(selectedIndex + step, 0), options.length - 1);
    if (next === selectedIndex) return;
    controls.zoom.selectedIndex = next;
    resize(around);
  };
  const mark = () => {
    probe.hidden = state.pixel === null;
    if (state.pixel === null) return;
    const [x, y] = state.pixel;
    Object.assign(probe.style, {
      left: `${(100 * x) / width}%`, top: `${(100 * y) / height}%`, width: `${100 / width}%`, height: `${100 / height}%`,
    });
  };
  const wordsOf = async (picture) => {
    const layer = chosenLayer(picture), values = await valuesOf(layer), [x, y] = state.pixel;
    const i = Math.floor(y / layer.block) * layer.width + Math.floor(x / layer.block);
    if (layer.kind === "label") return `${label(picture)}: ${labelOf(values, i) < 0 ? "none" : labelOf(values, i)}`;
    const shown = Array.from(values.subarray(layer.channels * i, layer.channels * (i + 1)));
    const scaled = layer.kind === "direction" ? shown.map((v) => 2 * v - 1) : shown;
    return `${label(picture)}: ${inUnit(scaled.map(digits).join("  "), layer)}`;
  };
  /** The values under the probe, and the error there if a picture is shown. */
  const tell = async () => {
    if (state.pixel === null) return;
    const all = [...new Set([...sides(), ...(hasReference ? [reference] : [])])], [x, y] = state.pixel;
    part("values").textContent = [`pixel ${x}, ${y}`, ...(await Promise.all(all.map(wordsOf)))].join("   ·   ");
  };
  const pointAt = (event) => {
    const box = stage.getBoundingClientRect();
    const x = Math.floor((width * (event.clientX - box.left)) / box.width);
    const y = Math.floor((height * (event.clientY - box.top)) / box.height);
    if (x < 0 || y < 0 || x >= width || y >= height) return;
    state.pixel = [x, y];
    mark();
    tell();
  };
  const middleInView = () => {
    const box = stage.getBoundingClientRect(), view = frame.getBoundingClientRect();
    const x = (view.left + view.width / 2 - box.left) / box.width, y = (view.top + view.height / 2 - box.top) / box.height;
    return [Math.floor(Math.min(x, 1) * width), Math.floor(Math.min(y, 1) * height)];
  };
  const moveProbe = (dx, dy) => {
    const [x, y] = state.pixel ?? middleInView();
    state.pixel = [Math.min(Math.max(x + dx, 0), width - 1), Math.min(Math.max(y + dy, 0), height - 1)];
    mark();
    tell();
    if (Number(controls.zoom.value)) probe.scrollIntoView({ block: "nearest", inline: "nearest" });
  };

  // ---------------------------------------------------------------- events

  const flip = () => {
    state.shown = state.flipping ? state.shown + 1 : 1;
    state.flipping = true;
    return show();
  };
  const divide = () => { state.flipping = false; return show(); };
  const dragDivider = (event) => {
    const { left, width: across } = inView();
    state.divided = Math.min(Math.max((100 * (event.clientX - left)) / across, 0), 100);
    controls.position.value = state.divided;
    arrange();
  };
  controls.left.addEventListener("change", show);
  controls.right.addEventListener("change", show);
  controls.layer.addEventListener("change", show);
  controls.position.addEventListener("input", () => { state.divided = Number(controls.position.value); arrange(); });
  controls.exposure.addEventListener("input", redevelopSoon);
  controls.curve.addEventListener("change", redevelop);
  controls.zoom.addEventListener("change", () => resize());
  controls.flip.addEventListener("click", flip);
  controls.divide.addEventListener("click", divide);

  // A press on the stage drags the divider or, where that is far away in a magnified picture, the picture.
  let held = null;
  stage.addEventListener("pointerdown", (event) => {
    const zoomed = Number(controls.zoom.value) > 0, near = Math.abs(event.clientX - divider.getBoundingClientRect().left) < 24;
    const kind = !state.flipping && pair && (!zoomed || near) ? "divider" : zoomed && event.pointerType === "mouse" ? "picture" : null;
    held = { kind, x: event.clientX, y: event.clientY, moved: false };
    if (kind) stage.setPointerCapture(event.pointerId);
    if (kind === "divider") dragDivider(event);
  });
  stage.addEventListener("pointermove", (event) => {
    pointAt(event);
    if (!held || !stage.hasPointerCapture(event.pointerId)) return;
    held.moved ||= Math.hypot(event.clientX - held.x, event.clientY - held.y) > 4;
    if (held.kind === "divider") dragDivider(event);
    else { frame.scrollLeft -= event.movementX; frame.scrollTop -= event.movementY; }
  });
  stage.addEventListener("click", (event) => {
    pointAt(event);
    if (state.flipping && !held?.moved) flip();
    held = null;
  });
  frame.addEventListener("scroll", arrange, { passive: true });
  frame.addEventListener("wheel", (event) => {
    if (!event.ctrlKey) return; // also a pinch on a touch pad
    event.preventDefault();
    zoomBy(event.deltaY < 0 ? 1 : -1, { x: event.clientX, y: event.clientY });
  }, { passive: false });
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  stage.addEventListener("keydown", (event) => {
    const step = arrows[event.key];
    if (!step || event.ctrlKey || event.metaKey || event.altKey) return;
    const far = event.shiftKey ? 10 : 1;
    moveProbe(far * step[0], far * step[1]);
    event.preventDefault();
  });
  const step = (control, by) => { by > 0 ? control.stepUp(by) : control.stepDown(-by); return redevelop(); };
  const keys = {
    ...(pair ? { f: flip, d: divide } : {}), "]": () => step(controls.exposure, 2), "[": () => step(controls.exposure, -2),
    "+": () => zoomBy(1), "=": () => zoomBy(1), "-": () => zoomBy(-1),
    l: () => { controls.layer.selectedIndex = (controls.layer.selectedIndex + 1) % layerNames.length; return show(); },
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select, textarea, input:not([type='range'])")) return;
    const digit = Number(event.key), act = keys[event.key.toLowerCase()];
    if (act) act();
    else if (digit >= 1 && digit <= names.length) { controls[pair ? "right" : "left"].value = String(digit - 1); show(); }
    else return;
    event.preventDefault();
  });

  root.hidden = false;
  resize();
  await redevelop();
};
