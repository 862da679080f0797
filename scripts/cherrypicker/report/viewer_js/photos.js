// A photo with the skeleton drawn over it, as it stands on the page.
import { css } from "viewer/colors.js";
import { place } from "viewer/data.js";
import { GONE, OFF } from "viewer/scene.js";

const SVG = "http://www.w3.org/2000/svg";
const SHOWN_PX = 900; // the longer side of a photo in the dialog

export function openPhoto(dialog, scene, camera) {
  const part = (name) => dialog.querySelector(`[data-part=${name}]`);
  for (const each of scene.data.cameras) each.picked = each === camera;
  scene.redraw();
  part("name").textContent = camera.name;
  const [wide, tall] = camera.size, zoom = SHOWN_PX / Math.max(wide, tall);
  const view = part("view");
  view.replaceChildren();
  view.style.width = `${zoom * wide}px`;
  const picture = camera.picture && document.getElementById(camera.picture);
  part("note").textContent = picture
    ? "As the photos judged it: green where they show wood before the sky, red where they show clear sky."
    : camera.photo ? "The skeleton as it stands in the view." : "This photo's picture is not in the page; the skeleton as it saw it.";
  if (picture) view.append(image(picture.src, camera.name));
  else {
    if (camera.photo) view.append(image(camera.photo, camera.name));
    view.append(lines(scene, camera));
  }
  view.style.aspectRatio = picture ? "auto" : `${wide} / ${tall}`;
  if (!dialog.open) dialog.showModal();
}

function image(source, name) {
  const element = document.createElement("img");
  element.src = source;
  element.alt = name;
  return element;
}

function lines(scene, camera) {
  const drawing = document.createElementNS(SVG, "svg");
  drawing.setAttribute("viewBox", `0 0 ${camera.size[0]} ${camera.size[1]}`);
  const { skeleton } = scene.data, { scheme, state } = scene.layer, paths = new Map(), m = camera.matrix;
  const project = (node) => {
    const [x, y, z] = place(skeleton.points, node);
    const depth = m[8] * x + m[9] * y + m[10] * z + m[11];
    if (depth < 1e-4) return null;
    return [m[0] * x + m[1] * y + m[2] * z + m[3], m[4] * x + m[5] * y + m[6] * z + m[7]].map((v) => (v / depth).toFixed(1));
  };
  for (let node = 1; node < skeleton.n; node++) {
    const parent = skeleton.parent[node];
    if (parent < 0 || state[node] === GONE || state[node] === OFF) continue;
    const from = project(parent), to = project(node);
    if (!from || !to) continue;
    const color = css(scheme.color(node));
    paths.set(color, (paths.get(color) || "") + `M${from}L${to}`);
  }
  for (const [color, way] of paths) {
    const path = document.createElementNS(SVG, "path");
    path.setAttribute("d", way);
    path.setAttribute("stroke", color);
    drawing.append(path);
  }
  return drawing;
}
