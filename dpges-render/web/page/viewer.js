// The page: loads a scene, shows it, and draws again only when something has changed.

import init, { Viewer } from "./pkg/dpges_web.js";
import { Controls, calm, isForScene } from "./controls.js";
import { download, embedded, sizeOf, nameOf, webAddress } from "./download.js";
import { fetchWanted, openLevels } from "./levels.js";

// What scenes of blended Gaussians or discs cannot show.
const OF_LAYERS = ["surfels", "depth", "normal", "layer_count"];
// Pictures beyond this many px per CSS px cost more than they show.
const LARGEST_RATIO = 2;
// How often a device that draws nothing is asked whether it was lost, ms.
const FAULT_CHECK_MS = 1000;
// Frames farther apart than this were not drawn one after the other, ms.
const PAUSE_MS = 1000;
// Time that begins a movement, ms: the frame before it may be long ago.
const FIRST_MS = 16;
// Share of the newest frame in the mean frame time.
const NEWEST = 0.1;

const NEEDS = "This page needs WebGPU or WebGL2: update the browser, and switch hardware acceleration on in its settings.";

const element = (id) => document.getElementById(id);
const canvas = element("canvas");
const settings = element("settings");
const views = element("views");
const parameters = new URLSearchParams(location.search);
const ofPage = (name) => document.querySelector(`meta[name="dpges-${name}"]`).content || null;
const parameter = (name) => parameters.get(name) ?? null;
// A page in one file has its parts in itself, under names that begin so.
const isWhole = ofPage("scene")?.startsWith("#");

let viewer;
let largestPx = 0;
let scene = null;
let address = null;
let loading = null;
// Of the cells of the scene that is shown.
let streaming = new AbortController();
// w: the slider has it as a power of ten, rounded.
let modulation = 1;
let frameMs = 0;
let drawnAt = 0;
// Whether the view goes on by itself since the last frame.
let moving = false;
let pending = false;
// Draws again when a cell that could not be loaded is tried again.
let retry = 0;
let faulty = false;

new Controls(canvas, () => (scene && !faulty ? viewer : null), draw);

// What a test needs to see; nothing in the page uses it.
export const page = { get viewer() { return viewer; }, get scene() { return scene; }, draw, options, picture };

function state(name) {
  document.documentElement.dataset.state = name;
  element("start").hidden = name !== "empty";
  element("progress").hidden = name !== "loading";
}

function fail(error) {
  console.error(error);
  const crashed = error instanceof WebAssembly.RuntimeError;
  const crash = "The viewer stopped: load the page again. The browser's console says more.";
  element("message-text").textContent = crashed ? crash : error.message ?? String(error);
  element("message").hidden = false;
  for (const button of document.querySelectorAll(".recover")) button.hidden = crashed || faulty || !viewer;
  if (crashed || !scene) state("failed");
}

function say(text) {
  element("progress-text").textContent = text;
}

// --- Loading ---

async function start() {
  const poster = parameter("poster") ? webAddress(parameter("poster"), location.href) : ofPage("poster");
  if (poster) showPoster(poster);
  if (parameter("controls") === "0") document.documentElement.dataset.controls = "0";
  state("loading");
  say("Starting");
  await init(isWhole ? { module_or_path: await embedded("wasm") } : undefined);
  try {
    viewer = await Viewer.create(canvas, parameter("backend") ?? "auto");
  } catch (error) {
    throw new Error(`${error.message} ${NEEDS}`);
  }
  const device = JSON.parse(viewer.device());
  largestPx = device.largest_px;
  element("device").textContent = `${device.backend}, ${device.precision_bits}-bit sums${device.adapter ? `, ${device.adapter}` : ""}`;
  setInterval(checkFault, FAULT_CHECK_MS);
  if (isWhole && !parameter("url")) return loadEmbedded();
  const url = parameter("url") ?? ofPage("scene");
  if (!url) return state("empty");
  await loadAddress(webAddress(url, location.href));
}

function showPoster(url) {
  element("poster").src = url;
  element("poster").hidden = false;
}

// The scene in this file, with its views and its path.
async function loadEmbedded() {
  const text = async (name) => new TextDecoder().decode(await embedded(name));
  const bytes = await embedded("scene");
  const path = ofPage("path") ? await text("path") : null;
  await show(() => loadBytes(bytes, document.title), { views: await text("cameras"), path });
  address = location.href;
}

async function loadAddress(url) {
  loading?.abort();
  loading = new AbortController();
  const signal = loading.signal;
  state("loading");
  say(nameOf(url));
  const path = parameter("path") ?? (url === new URL(ofPage("scene") ?? "", location.href).href ? ofPage("path") : null);
  const beside = {
    views: fetchText(parameter("cameras") ?? new URL("cameras.json", url), signal),
    path: path && fetchText(path, signal),
  };
  const found = async () => ({ views: await beside.views, path: await beside.path });
  if (new URL(url).pathname.endsWith(".json")) {
    const budget = Number(parameter("budget")) || undefined;
    const progress = (share) => { element("progress-bar").value = share; };
    const texts = await found();
    const opened = await openLevels(viewer, url, budget, progress, signal);
    address = url;
    return show(() => opened, texts);
  }
  const bytes = await download(url, (size, total) => {
    element("progress-bar").value = total ? size / total : 0;
    if (!total) element("progress-bar").removeAttribute("value");
    say(`${nameOf(url)}: ${sizeOf(size)}${total ? ` of ${sizeOf(total)}` : ""}`);
  }, signal);
  const name = nameOf(url);
  await show(() => loadBytes(bytes, name), await found());
  address = url;
}

// The text at an address, or null: a scene without cameras is looked at from outside.
async function fetchText(place, signal) {
  const url = webAddress(place, location.href);
  try {
    const response = await fetch(url, { signal });
    return response.ok ? await response.text() : null;
  } catch (error) {
    console.warn(`${url} is not used: ${error.message}`);
    return null;
  }
}

async function loadFile(file) {
  loading?.abort();
  state("loading");
  say(`${file.name}: ${sizeOf(file.size)}`);
  element("progress-bar").removeAttribute("value");
  const bytes = new Uint8Array(await file.arrayBuffer());
  await show(() => loadBytes(bytes, file.name), {});
  address = null;
}

function loadBytes(bytes, name) {
  try {
    return viewer.load(bytes, name);
  } catch (error) {
    throw new Error(error.message + hint(bytes));
  }
}

// Shows what `load` gives the viewer, which describes it as JSON, with the texts of its views and its camera path.
async function show(load, { views, path }) {
  element("message").hidden = true;
  // The browser draws the text before the page is busy.
  await new Promise((resolve) => setTimeout(resolve));
  try {
    scene = JSON.parse(load());
  } catch (error) {
    state(scene ? "shown" : "failed");
    throw error;
  }
  streaming.abort();
  streaming = new AbortController();
  frameMs = 0;
  fillSettings();
  fillViews(used(views, "the views", (text) => JSON.parse(viewer.set_views(text))) ?? []);
  element("play").hidden = used(path, "the camera path", (text) => viewer.set_path(text) ?? true) === null;
  reset();
  openNamed(parameter("view"));
  state("shown");
  drawNow();
  element("poster").hidden = true;
}

// What `take` makes of a text; null if there is none, or if it is wrong, which is said.
function used(text, what, take) {
  try {
    return text ? take(text) : null;
  } catch (error) {
    tell(`Shown without ${what}: ${error.message}`);
    return null;
  }
}

function tell(text) {
  element("message-text").textContent = text;
  element("message").hidden = false;
}

function fillViews(names) {
  const options = names.map((name, i) => new Option(name || `view ${i + 1}`, i));
  views.replaceChildren(new Option("Views", ""), ...options);
  views.hidden = names.length < 2;
}

// The view that the address asks for.
function openNamed(name) {
  if (!name) return;
  const found = [...views.options].find((option) => option.value && option.text === name);
  if (!found) return tell(`No view is called "${name}": choose one below.`);
  views.value = found.value;
  viewer.go_to(Number(found.value), true);
}

function goTo(view) {
  viewer.go_to(view, calm.matches);
  draw();
}

function stepView(by) {
  const count = views.options.length - 1;
  if (count < 1) return;
  const next = views.value === "" ? 0 : (Number(views.value) + by + count) % count;
  views.value = String(next);
  goTo(next);
}

views.addEventListener("change", () => {
  if (views.value !== "") goTo(Number(views.value));
});

// What a file that is no scene may be instead.
function hint(bytes) {
  const opening = new TextDecoder().decode(bytes.subarray(0, 16)).trimStart().toLowerCase();
  if (opening.startsWith("<")) return ". It is a web page: check the address.";
  if (opening.startsWith("ply") || opening.startsWith("gltf")) return ". This page shows the scene.safetensors that dpges writes.";
  return "";
}

// --- Drawing ---

function reset() {
  const whole = viewer.reset(settings.up.value);
  views.value = views.options.length > 1 ? "0" : "";
  const field = Number(parameter("fov"));
  const asked = field > 0 && field < 170;
  if (asked) viewer.set_field(field);
  settings.field.value = asked ? field : whole;
  labelSettings();
  draw();
}

// Width and height of the picture, px.
function size() {
  const ratio = Math.min(devicePixelRatio, LARGEST_RATIO) * Number(settings.scale.value);
  const px = (length) => Math.min(Math.max(Math.round(length * ratio), 1), largestPx);
  return [px(canvas.clientWidth), px(canvas.clientHeight)];
}

// The options as the viewer takes them.
function options() {
  return {
    display: settings.display.value,
    layer_count: Number(settings.layers.value),
    modulation,
    peeling: settings.peeling.value,
    background: settings.background.value.match(/[0-9a-f]{2}/gi).map((byte) => parseInt(byte, 16) / 255),
  };
}

function draw() {
  if (pending || faulty || !scene) return;
  pending = true;
  requestAnimationFrame(frame);
}

function frame(now) {
  pending = false;
  const passed = now - drawnAt;
  if (passed < PAUSE_MS && drawnAt > 0) frameMs = frameMs > 0 ? frameMs + NEWEST * (passed - frameMs) : passed;
  drawnAt = now;
  try {
    drawNow(moving ? passed : FIRST_MS);
  } catch (error) {
    fail(error);
  }
}

// The frame `ms` after the one before.
function drawNow(ms = 0) {
  moving = viewer.advance(ms / 1000, ...size(), JSON.stringify(options()));
  if (moving) draw();
  if (!viewer.draw()) draw();
  element("play").textContent = viewer.is_playing() ? "Stop" : "Play";
  describe(stream());
}

// Fetches what the frame asks for of a scene in levels of detail. Returns how far it is, or null.
function stream() {
  const levels = viewer.levels();
  if (!levels) return null;
  const status = JSON.parse(levels);
  fetchWanted(viewer, address, draw, streaming.signal);
  if (status.changing) draw();
  clearTimeout(retry);
  if (status.retry_in !== null) retry = setTimeout(draw, 1000 * status.retry_in);
  return status;
}

// The picture of a camera and options as ImageData, read back from a texture.
async function picture(entry, options) {
  viewer.set_view(JSON.stringify(entry), JSON.stringify(options));
  return new ImageData(await viewer.read_pixels(), entry.width, entry.height);
}

function describe(levels) {
  const count = (number) => number.toLocaleString("en");
  const time = frameMs > 0 ? ` · ${frameMs.toFixed(1)} ms` : "";
  const parts = [`${count(scene.surfels)} surfels · ${count(scene.gaussians)} Gaussians${time}`];
  if (levels) parts.push(`${count(levels.resident)} of at most ${count(levels.budget)} in memory`);
  if (levels?.loading) parts.push(`${levels.loading} parts are being loaded`);
  if (levels?.failed) parts.push(`${levels.failed} parts could not be loaded and stay coarse: ${levels.reason}`);
  element("status").textContent = parts.join(" · ");
  const times = viewer.pass_times();
  element("status").title = times ? JSON.parse(times).map(([name, ms]) => `${name} ${ms.toFixed(2)} ms`).join(", ") : "";
}

function checkFault() {
  const fault = viewer.fault();
  if (!fault || faulty) return;
  faulty = true;
  fail(new Error(`${fault}. Load the page again; if it happens again, try the parameter backend=webgl, or a smaller scene.`));
}

// --- Settings ---

function fillSettings() {
  for (const option of settings.display.options) {
    option.disabled = scene.rendering !== "peeled" && OF_LAYERS.includes(option.value);
  }
  const hex = (value) => Math.round(Math.min(Math.max(value, 0), 1) * 255).toString(16).padStart(2, "0");
  const background = parameter("background");
  settings.display.value = parameter("display") ?? "image";
  settings.layers.value = parameter("k") ?? scene.layer_count;
  modulation = Number(parameter("w")) > 0 ? Number(parameter("w")) : scene.modulation;
  settings.hardness.value = Math.log10(modulation);
  settings.peeling.value = parameter("peeling") ?? scene.peeling;
  settings.background.value = /^[0-9a-f]{6}$/i.test(background) ? `#${background}` : `#${scene.background.map(hex).join("")}`;
  settings.scale.value = parameter("scale") ?? "1";
  settings.up.value = parameter("up") ?? "";
  for (const select of [settings.display, settings.peeling, settings.scale, settings.up]) {
    if (select.selectedIndex < 0 || select.selectedOptions[0].disabled) select.selectedIndex = 0;
  }
}

function labelSettings() {
  const label = (input, text) => {
    input.parentElement.querySelector(".value").textContent = text;
    input.setAttribute("aria-valuetext", text);
  };
  label(settings.layers, settings.layers.value);
  label(settings.hardness, modulation.toFixed(1));
  label(settings.field, `${Math.round(settings.field.value)}°`);
}

settings.addEventListener("input", (event) => {
  if (event.target === settings.field) viewer.set_field(Number(settings.field.value));
  if (event.target === settings.hardness) modulation = 10 ** Number(settings.hardness.value);
  if (event.target === settings.up) return reset();
  labelSettings();
  draw();
});
settings.addEventListener("submit", (event) => event.preventDefault());

// --- Buttons, keys, files ---

function embed() {
  const url = new URL(location.href);
  if (address && !ofPage("scene")) url.searchParams.set("url", address);
  const text = `<iframe src="${url.href.replaceAll("&", "&amp;").replaceAll('"', "%22")}" title="dpges scene" width="800" height="450"`
    + ` style="border:0" loading="lazy" allow="fullscreen; webgpu"></iframe>`;
  const local = !address || !url.hostname || /^(localhost|127\.|\[::1\])/.test(url.hostname);
  element("embed-note").textContent = local
    ? "This scene is on your device only: put it on a web server, then open it from there."
    : "Copy this into your page.";
  element("embed-text").value = text;
  showSettings(false);
  element("embed").showModal();
}

async function copy() {
  element("embed-text").select();
  try {
    await navigator.clipboard.writeText(element("embed-text").value);
    element("embed-note").textContent = "Copied.";
  } catch {
    element("embed-note").textContent = "The text is selected: press Ctrl+C.";
  }
}

function showSettings(shown) {
  settings.hidden = !shown;
  document.querySelector('[data-action="settings"]').setAttribute("aria-expanded", String(shown));
}

const actions = {
  open: () => element("file").click(),
  dismiss: () => {
    element("message").hidden = true;
    if (!scene) state("empty");
  },
  reset,
  play: () => {
    viewer.play_or_stop();
    draw();
  },
  fullscreen: () => (document.fullscreenElement ? document.exitFullscreen() : element("stage").requestFullscreen()),
  settings: () => showSettings(settings.hidden),
  embed,
  copy,
  help: () => element("help").showModal(),
};
const keys = { KeyR: "reset", Space: "play", KeyF: "fullscreen", KeyT: "settings", KeyH: "help" };

document.addEventListener("click", (event) => {
  const action = event.target.closest("[data-action]")?.dataset.action;
  if (action) actions[action]();
});
document.addEventListener("keydown", (event) => {
  if (!scene || !isForScene(event)) return;
  if (event.code in keys) actions[keys[event.code]]();
  if (event.code === "PageUp" || event.code === "PageDown") stepView(event.code === "PageUp" ? -1 : 1);
  const display = /^Digit([1-8])$/.exec(event.code);
  if (display) {
    const option = settings.display.options[Number(display[1]) - 1];
    if (!option.disabled) settings.display.value = option.value;
    draw();
  }
});
if (!document.fullscreenEnabled) document.querySelector('[data-action="fullscreen"]').hidden = true;

element("file").addEventListener("change", () => {
  const [file] = element("file").files;
  element("file").value = "";
  if (file) loadFile(file).catch(fail);
});
let over = 0;
const dropping = (change) => document.documentElement.classList.toggle("dropping", (over = change === 0 ? 0 : over + change) > 0);
addEventListener("dragenter", () => dropping(1));
addEventListener("dragleave", () => dropping(-1));
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  dropping(0);
  const [file] = event.dataTransfer.files;
  if (file && viewer) loadFile(file).catch(fail);
});

canvas.addEventListener("webglcontextlost", () => {
  faulty = true;
  fail(new Error("The graphics device was lost: load the page again."));
});
new ResizeObserver(draw).observe(canvas);

start().catch((error) => {
  if (error.name !== "AbortError") fail(error);
});
