"use strict";
// The page is complete without this script. With it, the pictures get an exposure and the comparison appears.
(async () => {
  const data = JSON.parse(document.getElementById("pictures").textContent);
  const { width, height, names, planes } = data;
  const count = width * height;
  const find = (id) => document.getElementById(id);
  if (typeof DecompressionStream === "undefined") return;

  // Shared-exponent pixels [Ward 1991]: planes of red, green and blue mantissas and of the exponent.
  const unpack = async (text) => {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };
  const pictures = await Promise.all(planes.map(unpack));

  // A tone curve is encode(after f(before x)), f and encode as tables: f at equal steps of log2 x, encode of squares.
  const at = (table, place) => {
    const i = Math.min(Math.max(Math.floor(place), 0), table.length - 2);
    return table[i] + Math.min(Math.max(place - i, 0), 1) * (table[i + 1] - table[i]);
  };
  const [lowest, highest] = data.range;
  const f = (curve, x) => {
    if (x < 2 ** lowest) return (x / 2 ** lowest) * curve.f[0];
    return at(curve.f, (Math.log2(x) - lowest) * ((curve.f.length - 1) / (highest - lowest)));
  };
  const encode = (curve, y) => Math.round(255 * at(curve.encode, Math.sqrt(Math.min(Math.max(y, 0), 1)) * (curve.encode.length - 1)));
  // One entry for each mantissa under each exponent: exposed values, and bytes if the channels do not mix.
  const exposed = new Float64Array(65536), bytes = new Uint8Array(65536);
  let chosen = data.curves[data.curve];
  const fillTable = (stops, curve) => {
    chosen = data.curves[curve];
    for (let e = 0; e < 256; e++) {
      for (let m = 0; m < 256; m++) {
        const x = Math.min(m * 2 ** (e - 136 + stops), 1e30), i = (e << 8) | m;
        exposed[i] = x;
        if (!chosen.before) bytes[i] = encode(chosen, f(chosen, x));
      }
    }
  };
  const developed = names.map(() => new ImageData(width, height));
  const mix = (row, r, g, b) => row[0] * r + row[1] * g + row[2] * b;
  const develop = (index) => {
    const source = pictures[index], target = developed[index].data, { before, after } = chosen;
    for (let i = 0; i < count; i++) {
      const e = source[3 * count + i] << 8;
      const r = e | source[i], g = e | source[count + i], b = e | source[2 * count + i];
      if (before) {
        const [x, y, z] = before.map((row) => f(chosen, mix(row, exposed[r], exposed[g], exposed[b])));
        for (let k = 0; k < 3; k++) target[4 * i + k] = encode(chosen, mix(after[k], x, y, z));
      } else {
        target[4 * i] = bytes[r];
        target[4 * i + 1] = bytes[g];
        target[4 * i + 2] = bytes[b];
      }
      target[4 * i + 3] = 255;
    }
  };
  const makeCanvas = (label) => {
    const canvas = document.createElement("canvas");
    canvas.width = width;
    canvas.height = height;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", label);
    return canvas;
  };
  const thumbnails = names.map((name, index) => {
    const image = document.querySelector(`img[data-picture="${index}"]`);
    const canvas = makeCanvas(image.alt);
    image.replaceWith(canvas);
    return canvas;
  });

  const stage = find("stage"), left = find("left"), right = find("right"), position = find("position");
  const exposure = find("exposure"), exposureValue = find("exposure-value"), curve = find("curve");
  const leftTag = find("left-tag"), rightTag = find("right-tag"), divider = find("divider"), flipButton = find("flip");
  const back = makeCanvas("picture on the right"), front = makeCanvas("picture on the left");
  stage.prepend(back, front);
  stage.style.aspectRatio = `${width} / ${height}`;
  let flipping = false, showLeft = true, zoom = "fit", divided = 50;

  const show = () => {
    const a = Number(left.value), b = Number(right.value);
    front.getContext("2d").putImageData(developed[a], 0, 0);
    back.getContext("2d").putImageData(developed[b], 0, 0);
    const share = flipping ? (showLeft ? 100 : 0) : divided;
    front.style.clipPath = `inset(0 ${100 - share}% 0 0)`;
    divider.style.left = `${share}%`;
    divider.hidden = flipping;
    leftTag.textContent = names[a];
    rightTag.textContent = names[b];
    leftTag.hidden = flipping && !showLeft;
    rightTag.hidden = flipping && showLeft;
    front.setAttribute("aria-label", names[a]);
    back.setAttribute("aria-label", names[b]);
    flipButton.setAttribute("aria-pressed", String(flipping));
    flipButton.textContent = flipping ? `Flip: ${names[showLeft ? a : b]}` : "Flip";
    find("position-row").hidden = flipping;
    find("divide").setAttribute("aria-pressed", String(!flipping));
    stage.classList.toggle("flipping", flipping);
  };
  const redevelop = () => {
    const stops = Number(exposure.value);
    exposureValue.textContent = `${stops > 0 ? "+" : ""}${stops.toFixed(1)}`;
    fillTable(data.exposure + stops, curve.value);
    names.forEach((_, index) => {
      develop(index);
      thumbnails[index].getContext("2d").putImageData(developed[index], 0, 0);
    });
    show();
  };
  const resize = () => {
    // "fit" never shows a picture more than twice its size; the other choices are whole pixels of the picture.
    const factor = zoom === "fit" ? 0 : Number(zoom);
    stage.style.width = factor ? `${factor * width}px` : `min(100%, ${2 * width}px, ${(80 * width) / height}vh)`;
    stage.classList.toggle("pixels", factor > 1);
    document.querySelectorAll("[data-zoom]").forEach((b) => b.setAttribute("aria-pressed", String(b.dataset.zoom === zoom)));
  };
  const flip = () => {
    if (flipping) showLeft = !showLeft;
    flipping = true;
    show();
  };
  const drag = (event) => {
    const box = stage.getBoundingClientRect();
    divided = Math.min(Math.max((100 * (event.clientX - box.left)) / box.width, 0), 100);
    position.value = divided;
    show();
  };

  for (const [index, name] of names.entries()) {
    left.add(new Option(name, index, false, index === data.left));
    right.add(new Option(name, index, false, index === data.right));
  }
  curve.value = data.curve;
  find("viewer").classList.toggle("single", names.length < 2);
  left.addEventListener("change", show);
  right.addEventListener("change", show);
  position.addEventListener("input", () => { divided = Number(position.value); show(); });
  exposure.addEventListener("input", redevelop);
  curve.addEventListener("change", redevelop);
  flipButton.addEventListener("click", flip);
  find("divide").addEventListener("click", () => { flipping = false; show(); });
  document.querySelectorAll("[data-zoom]").forEach((button) => {
    button.addEventListener("click", () => { zoom = button.dataset.zoom; resize(); });
  });
  // A click, not a press: in this mode a touch may also be the start of scrolling a magnified picture.
  stage.addEventListener("click", () => { if (flipping) flip(); });
  stage.addEventListener("pointerdown", (event) => {
    if (flipping) return;
    stage.setPointerCapture(event.pointerId);
    drag(event);
  });
  stage.addEventListener("pointermove", (event) => {
    if (!flipping && stage.hasPointerCapture(event.pointerId)) drag(event);
  });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select, input[type='text']")) return;
    const digit = Number(event.key);
    if (event.key === "f" || event.key === "F") flip();
    else if (event.key === "d" || event.key === "D") { flipping = false; show(); }
    else if (event.key === "+" || event.key === "=") { exposure.stepUp(2); redevelop(); }
    else if (event.key === "-") { exposure.stepDown(2); redevelop(); }
    else if (digit >= 1 && digit <= names.length) { right.value = String(digit - 1); show(); }
    else return;
    event.preventDefault();
  });
  find("viewer").hidden = false;
  resize();
  redevelop();
  document.documentElement.dataset.ready = "true";
})();
