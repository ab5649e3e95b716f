// What a page does beyond its markup, which is complete without: theme, copying, printing, the viewer of pictures.
import { canUnpack } from "etendue/float.js";
import { pictureViewer } from "etendue/pictures.js";

const THEMES = ["auto", "light", "dark"], KEY = "etendue-theme";
const theme = document.getElementById("theme");
const setTheme = (name) => {
  if (name === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = name;
  theme.textContent = `Theme: ${name}`;
};
let chosen = "auto";
try { chosen = localStorage.getItem(KEY) ?? "auto"; } catch { /* not kept between visits */ }
if (!THEMES.includes(chosen)) chosen = "auto";
setTheme(chosen);
theme.hidden = false;
theme.addEventListener("click", () => {
  chosen = THEMES[(THEMES.indexOf(chosen) + 1) % THEMES.length];
  setTheme(chosen);
  try { localStorage.setItem(KEY, chosen); } catch { /* not kept between visits */ }
});

for (const button of document.querySelectorAll("[data-copy]")) {
  button.hidden = !navigator.clipboard;
  button.addEventListener("click", async () => {
    await navigator.clipboard.writeText(button.parentElement.querySelector("code").textContent);
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  });
}

// On paper everything is open.
const closed = [];
addEventListener("beforeprint", () => {
  for (const details of document.querySelectorAll("details:not([open])")) {
    details.open = true;
    closed.push(details);
  }
});
addEventListener("afterprint", () => closed.splice(0).forEach((details) => { details.open = false; }));

const data = document.getElementById("pictures");
if (data && canUnpack()) {
  const thumbnails = [];
  for (const image of document.querySelectorAll("img[data-picture]")) {
    const canvas = document.createElement("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", image.alt);
    canvas.style.aspectRatio = `${image.getAttribute("width")} / ${image.getAttribute("height")}`;
    thumbnails[Number(image.dataset.picture)] = canvas;
    image.replaceWith(canvas);
  }
  await pictureViewer(document.querySelector("[data-viewer]"), JSON.parse(data.textContent), thumbnails);
}
document.documentElement.dataset.ready = "true";
