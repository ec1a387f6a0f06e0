// What a user does: keys, pointers, a gamepad and the panel move the camera and choose what is shown.

import { Camera, drag, wheeled } from "./camera.js";
import { hit, meaning } from "./draw.js";
import { $, change, choose, list, paint, paused, rectangle, stage, state, step, twoModels } from "./page.js";

/** Keys that are held, and a gamepad. */
export function steer(now) {
  const dt = Math.min(0.1, (now - (state.now ?? now)) / 1000);
  state.now = now;
  if (!state.camera) return;
  const down = (key) => (state.keys.has(key) ? 1 : 0);
  const pad = [...(navigator.getGamepads?.() ?? [])].find(Boolean);
  const axis = (i) => { const v = pad?.axes[i] ?? 0; return Math.abs(v) > 0.12 ? v : 0; };
  const button = (i) => pad?.buttons[i]?.value ?? 0;
  const fast = dt * (state.keys.has("shift") ? 4 : 1);
  const move = [down("d") - down("a") + axis(0), down("q") - down("e") + button(6) - button(7), down("w") - down("s") - axis(1)];
  if (move.some((v) => v !== 0)) {
    state.camera.fly(...move.map((v) => v * fast));
    change(true);
  }
  if (axis(2) || axis(3)) {
    state.camera.look(2 * dt * axis(2), -2 * dt * axis(3));
    change(true);
  }
}

function dragged(event) {
  const before = state.pointers.get(event.pointerId);
  if (!before || !state.camera) return;
  before.far ||= Math.hypot(event.clientX - before.x0, event.clientY - before.y0) > 4;
  if (!before.far) {
    [before.x, before.y] = [event.clientX, event.clientY];
    return;
  }
  const [, , , height] = rectangle();
  drag(state.camera, state.pointers, event, height);
  change(true);
}

export function listen() {
  stage.addEventListener("pointerdown", (event) => {
    stage.setPointerCapture(event.pointerId);
    const { clientX: x, clientY: y, button } = event;
    state.pointers.set(event.pointerId, { x, y, x0: x, y0: y, button, far: false });
  });
  stage.addEventListener("pointermove", dragged);
  for (const name of ["pointerup", "pointercancel"]) {
    stage.addEventListener(name, (event) => {
      const pointer = state.pointers.get(event.pointerId);
      state.pointers.delete(event.pointerId);
      if (!pointer || pointer.far || !$("frusta").checked || state.photo >= 0 || !state.camera) return;
      const { left, top } = stage.getBoundingClientRect();
      const n = hit([event.clientX - left, event.clientY - top], rectangle(), state.camera, state.scene.cameras, state.length);
      if (n >= 0) choose(n);
    });
  }
  stage.addEventListener("contextmenu", (event) => event.preventDefault());
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    state.camera?.dolly(wheeled(event));
    change(true);
  }, { passive: false });
  addEventListener("keydown", (event) => {
    const typing = event.target.matches?.("select, input[type=range]");
    if (typing || event.ctrlKey || event.metaKey || event.altKey || !state.camera) return;
    const key = event.key.toLowerCase();
    if (key === "arrowleft" || key === "arrowright") step(key === "arrowleft" ? -1 : 1);
    else if (key === "home") home();
    else if (key === "l") { state.camera.level(); change(true); }
    else if (key === "h" && !event.repeat) $("panel").hidden = !$("panel").hidden;
    else if (/^[1-9]$/.test(key) && Number(key) <= $("kind").options.length) { $("kind").selectedIndex = Number(key) - 1; kind(); }
    else { state.keys.add(key); return; }
    event.preventDefault();
  });
  addEventListener("keyup", (event) => state.keys.delete(event.key.toLowerCase()));
  addEventListener("blur", () => state.keys.clear());
  addEventListener("hashchange", () => restore(location.hash.slice(1)));
  // After a choice by pointer, keys belong to the camera again; whoever chooses by keys goes on with them.
  let pointed = false;
  $("panel").addEventListener("pointerdown", () => { pointed = true; });
  $("panel").addEventListener("keydown", () => { pointed = false; });
  $("panel").addEventListener("change", (event) => { if (pointed) event.target.blur(); });
  $("kind").addEventListener("change", kind);
  $("models").addEventListener("change", () => { state.model = Number($("models").value); legend(); change(); });
  $("split").addEventListener("input", () => { paint(); if (twoModels() && !state.other) change(); });
  for (const id of ["degree", "background", "width"]) $(id).addEventListener("change", () => change());
  $("home").addEventListener("click", home);
  $("level").addEventListener("click", () => { state.camera.level(); change(true); });
  $("sort").addEventListener("click", () => {
    const worst = $("sort").textContent === "worst first";
    $("sort").textContent = worst ? "by name" : "worst first";
    list(worst);
  });
  const control = (name) => state.socket?.send(JSON.stringify({ control: name }));
  $("pause").addEventListener("click", () => {
    control(state.paused ? "resume" : "pause");
    paused(!state.paused); // before the run's own news, which may be seconds away
  });
  $("checkpoint").addEventListener("click", () => control("checkpoint"));
  $("share").addEventListener("change", () => control({ share: Number($("share").value) }));
  $("stop").addEventListener("click", () => {
    const run = "Stop the run? It can be resumed.", compression = "Stop the compression? No model will be written.";
    if (confirm(state.scene.checkpoints ? run : compression)) control("stop");
  });
}

function kind() {
  state.kind = $("kind").value;
  legend();
  change();
}

function legend() {
  $("legend").textContent = meaning(state.kind, state.scene.models[state.model]?.pruned_by);
}

export function home() {
  const { start, target, up } = state.scene;
  if (!start) return;
  choose(-1);
  state.camera = new Camera(start, target, up, state.reach);
  change();
}

/** The view as text, so that its address can be sent to somebody. */
export function fragment() {
  if (state.photo >= 0) return `photo=${state.photo}&kind=${state.kind}`;
  const { position, rotation, fov, distance, shift, stretch } = state.camera;
  const numbers = [...position, ...rotation, fov, distance, ...shift, stretch].map((v) => Number(v.toPrecision(9)));
  return `pose=${numbers.join(",")}&kind=${state.kind}`;
}

export function restore(text) {
  const given = new URLSearchParams(text);
  if ([...$("kind").options].some((o) => o.value === given.get("kind"))) $("kind").value = state.kind = given.get("kind");
  legend();
  const numbers = (given.get("pose") ?? "").split(",").map(Number);
  if ([9, 11, 12].includes(numbers.length) && numbers.every(Number.isFinite)) {
    const [fov, distance, right = 0, down = 0, stretch = 1] = numbers.slice(7);
    const pose = { position: numbers.slice(0, 3), rotation: numbers.slice(3, 7), fov, shift: [right, down], stretch };
    state.camera = new Camera(pose, [0, 0, 0], state.scene.up, state.reach);
    state.camera.distance = Math.max(distance, 1e-6);
    change();
  }
  const n = Number(given.get("photo") ?? NaN);
  if (Number.isInteger(n) && n >= 0 && n < state.scene.cameras.length) choose(n);
}
