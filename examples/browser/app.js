// The page: opens the device, loads scenes, and asks for frames.

import init, { Page, panicked } from "./browser.js";
import { Plot, short } from "./plot.js";
import { listen } from "./pointer.js";
import { build } from "./sliders.js";

const get = (id) => document.getElementById(id);
const LARGEST_PICTURE = 2048; // pixels a side
const plots = { gradient: new Plot(get("gradient"), true), energy: new Plot(get("energy"), false), time: new Plot(get("time"), true) };
let page = null;
let playing = true;
let steps = 0; // single frames still to compute
let due = 0; // when the next frame is to begin [ms]
let shown = -1; // the last frame in the plots
let ended = false;
let scenes = [];

/** Shows a message, or none. */
function say(text) {
  get("message").hidden = !text;
  get("message").textContent = text ?? "";
}

/** Says that the page is at its end. */
function end(text) {
  ended = true;
  say(text);
  get("status").textContent = "Stopped";
  for (const control of document.querySelectorAll("button, select, input, fieldset")) control.disabled = true;
}

function play(wanted) {
  playing = wanted;
  get("pause").textContent = playing ? "Pause" : "Play";
}

/** What to do where there is no WebGPU. */
function withoutWebGpu() {
  if (!window.isSecureContext) return "This page needs WebGPU, which browsers offer to pages over https and from localhost only: open it from there.";
  return (
    "This browser has no WebGPU, which the page needs. Chrome and Edge have it from 113 on, Safari from 26, Firefox from 141 (on some systems later). " +
    "If yours is newer, WebGPU or graphics acceleration may be switched off in its settings."
  );
}

/** Returns the scene and its options as the form has them. */
function wanted() {
  const number = (id) => (get(id).value.trim() === "" && !get(id).validity.badInput ? null : get(id).valueAsNumber);
  return { scene: get("scene").value, solver: get("solver").value, iterations: number("iterations"), grid: number("grid") };
}

/** Says what happens in the scene that is chosen. */
function describe() {
  get("description").textContent = scenes.find(({ name }) => name === get("scene").value)?.description ?? "";
}

/** Loads a scene and shows it in form and address. */
async function load({ scene, ...options }) {
  say(null);
  get("status").textContent = "Setting up";
  // So that this can be read meanwhile.
  await new Promise((done) => setTimeout(done, 30));
  if (ended) return;
  try {
    page.load(scene, JSON.stringify(options));
  } catch (error) {
    get("status").textContent = "Choose a scene";
    fail(error);
    return;
  }
  const asked = { scene, solver: null, iterations: null, grid: null, ...options };
  for (const [id, value] of Object.entries(asked)) if (value !== null || id !== "solver") get(id).value = value ?? "";
  describe();
  const entries = Object.entries(asked).filter(([, value]) => value !== null);
  history.replaceState(null, "", `?${new URLSearchParams(entries)}`);
  restart();
  showSettings(JSON.parse(page.settings()));
}

/** Shows an error that the page survives, unless the program has ended. */
function fail(error) {
  if (error instanceof WebAssembly.RuntimeError) end(`The program failed: ${panicked() || error.message}. Reload the page to begin again.`);
  else say(error.message);
}

/** Empties the plots. */
function restart() {
  [shown, due, steps] = [-1, 0, 0];
  Object.values(plots).forEach((plot) => plot.clear());
}

function reset() {
  attempt(() => page.reset());
  say(null);
  restart();
}

function attempt(act) {
  if (!page || ended) return;
  try {
    act();
  } catch (error) {
    fail(error);
  }
}

const showSettings = build(get("sliders"), (field, value) => attempt(() => page.set(field, value)));

/** Shows why the page cannot go on. */
function showFault({ kind, text }) {
  if (kind === "lost") end(`The graphics device was lost: ${text}. Reload the page to begin again; if it happens again, choose fewer particles or iterations.`);
  else if (kind === "non-finite") say(`${text}: the simulation has stopped. Reset begins again; a softer or heavier cloth, more iterations or another solver may help.`);
  else say(`The simulation has stopped: ${text}. Another scene, grid or solver may do.`);
  play(false);
}

function show(status) {
  if (status.frame === undefined) return;
  const { frame, frames, grid, energy, took_ms: took } = status;
  const parts = [
    `frame ${frame} of ${frames - 1}`,
    `${(frame * status.frame_time_s).toFixed(2)} s`,
    `energy ${energy === null ? "-" : energy.toFixed(6)}`,
    `${took === null ? "-" : took.toFixed(1)} ms per frame`,
    `${grid[0]}x${grid[1]}`,
    `${status.iterations} iterations`,
  ];
  get("status").textContent = parts.join(", ");
  if (frame === shown) return;
  if (frame > 0 && frame > shown) {
    plots.gradient.push(status.gradient);
    plots.energy.push(energy);
    plots.time.push(took);
  }
  shown = frame;
  Object.values(plots).forEach((plot) => plot.draw());
}

/** Computes a frame if one is due, and shows what has come. */
function tick(now) {
  if (ended) return;
  requestAnimationFrame(tick);
  attempt(() => {
    const computed = page.frame(steps > 0 || (playing && now >= due - 2));
    const status = JSON.parse(page.status());
    const length = 1000 * (status.frame_time_s ?? 0);
    if (computed) {
      steps = Math.max(steps - 1, 0);
      due = Math.max(due + length, now);
    }
    if (status.fault) {
      if (get("message").hidden) showFault(status.fault);
    } else if (status.over && playing && get("repeat").checked) {
      attempt(() => page.reset());
      restart();
    }
    show(status);
  });
}

/** Lists the scenes in the form. */
function list() {
  const group = (label, entries) => {
    const options = entries.map(({ name, refused }) => {
      const option = new Option(refused ? `${name} (needs a file)` : name, name);
      option.disabled = refused !== null;
      option.title = refused ?? "";
      return option;
    });
    const element = Object.assign(document.createElement("optgroup"), { label });
    element.append(...options);
    return element;
  };
  get("scene").append(group("Gallery", scenes.filter((scene) => scene.gallery)), group("Others", scenes.filter((scene) => !scene.gallery)));
}

function fit() {
  const canvas = get("picture");
  const scale = Math.min(window.devicePixelRatio || 1, LARGEST_PICTURE / Math.max(canvas.clientWidth, canvas.clientHeight, 1));
  attempt(() => page.resize(Math.round(scale * canvas.clientWidth), Math.round(scale * canvas.clientHeight)));
}

async function start() {
  if (!navigator.gpu) return end(withoutWebGpu());
  try {
    await init();
    page = await Page.open(get("picture"));
  } catch (error) {
    return end(
      `WebGPU is there, but no device could be opened: ${error.message}. A newer driver of the graphics card may help; Chrome tells more under chrome://gpu, Firefox under about:support.`,
    );
  }
  globalThis.fnopt = { page, load }; // for the console
  get("device").textContent = `Device: ${page.device()}`;
  scenes = JSON.parse(page.scenes());
  list();
  describe();
  for (const id of ["scene", "solver", "iterations", "grid"]) {
    get(id).disabled = false;
    get(id).addEventListener("change", () => {
      describe();
      load(wanted());
    });
  }
  for (const id of ["pause", "step", "reset", "sliders"]) get(id).disabled = false;
  get("controls").addEventListener("submit", (event) => event.preventDefault());
  const actions = {
    pause: () => play(!playing),
    step: () => {
      play(false);
      steps += 1;
    },
    reset,
  };
  Object.entries(actions).forEach(([id, act]) => get(id).addEventListener("click", act));
  const choose = () => attempt(() => page.choose());
  listen(get("picture"), () => (ended ? null : page), { " ": actions.pause, s: actions.step, r: reset, h: choose });
  new ResizeObserver(fit).observe(get("picture"));
  fit();

  // The address may say what to begin with.
  const asked = new URLSearchParams(location.search);
  if (asked.has("paused")) play(false);
  for (const id of ["scene", "solver", "iterations", "grid"]) if (asked.has(id)) get(id).value = asked.get(id);
  const first = wanted();
  const text = (id) => (asked.has(id) ? asked.get(id) : first[id]);
  await load({ ...first, scene: text("scene"), solver: text("solver") });
  requestAnimationFrame(tick);
}

start();
