// The viewer's page: asks for pictures over one WebSocket and shows them. Moving pictures are JPEG, still ones lossless.

import { Camera, drag, wheeled } from "./camera.js";
import { colours, draw, frustumLength, hit, meaning } from "./draw.js";

/** Milliseconds without a movement after which the picture counts as still. */
const REST = 150;
/** Milliseconds before the first attempt to connect again, and at most. */
const BACK_OFF = [500, 5000];
const HEADER = 32;

const $ = (id) => document.getElementById(id);
const picture = $("picture"), photo = $("photo"), lines = $("lines"), stage = $("stage");

const state = {
  scene: null, camera: null, photo: -1, model: 0, kind: "colour",
  sent: 0, received: 0, request: null, otherAsked: 0, changed: false, lastChange: 0, stillAsked: true, other: null, shown: null,
  keys: new Set(), pointers: new Map(), socket: null, wait: BACK_OFF[0], times: [],
};
globalThis.viewer = state;

const say = (text) => { $("message").textContent = text; };

// --- Requests -------------------------------------------------------------------------------------------------------------

/** Width and height to ask for: the stage's shape, no wider than chosen. */
function size() {
  const { width, height } = stage.getBoundingClientRect();
  const ratio = Math.min(globalThis.devicePixelRatio || 1, Number($("width").value) / Math.max(width, 1));
  return [Math.max(16, Math.round(width * ratio)), Math.max(16, Math.round(height * ratio))];
}

const twoModels = () => state.scene.models.length > 1 && Number($("split").value) > 0 && state.photo < 0;

function send(still, model) {
  if (state.socket?.readyState !== WebSocket.OPEN || !state.camera) return;
  const { position, rotation, fov } = state.camera;
  const grey = $("background").value;
  const request = {
    number: ++state.sent, size: size(), picture: state.kind, model, degree: Number($("degree").value), still,
    camera: state.photo >= 0 ? { photo: state.photo } : { pose: { position, rotation, fov } },
    background: grey === "" ? null : [Number(grey), Number(grey), Number(grey)],
  };
  state.request = request;
  state.socket.send(JSON.stringify({ request }));
}

/** Asks for the last picture again, of the other model. */
function sendOther() {
  if (state.socket?.readyState !== WebSocket.OPEN) return;
  const request = { ...state.request, number: ++state.sent, model: 1 - state.model };
  state.otherAsked = request.number;
  state.socket.send(JSON.stringify({ request }));
}

/** Notes that the next picture differs. `leave`: the camera has left the photo. */
function change(leave = false) {
  if (leave && state.photo >= 0) choose(-1);
  if (!twoModels()) forgetOther();
  state.changed = true;
  state.lastChange = performance.now();
  state.stillAsked = false;
}

function tick(now) {
  steer(now);
  const waiting = state.received < state.sent;
  // With two models, pictures come in turns: a request must not replace the other model's.
  if (state.changed && !(twoModels() && waiting)) {
    state.changed = false;
    send(false, state.model);
  } else if (!state.stillAsked && now - state.lastChange > REST && !(twoModels() && waiting)) {
    state.stillAsked = true;
    send(true, state.model);
    history.replaceState(null, "", `#${fragment()}`);
  }
  overlay();
  requestAnimationFrame(tick);
}

// --- Frames ---------------------------------------------------------------------------------------------------------------

function forgetOther() {
  state.other?.close();
  state.other = null;
}

async function receive(socket, data) {
  const view = new DataView(data);
  const word = (i) => view.getUint32(4 + 4 * i, true), real = (i) => view.getFloat32(4 + 4 * i, true);
  const frame = {
    lossless: view.getUint8(1) === 1, reduced: view.getUint8(2) === 1, size: [word(0), word(1)], number: word(2),
    ms: real(3), iteration: word(4), gaussians: word(5), figure: view.getUint8(3), value: real(6), bytes: data.byteLength - HEADER,
  };
  const blob = new Blob([new Uint8Array(data, HEADER)], { type: frame.lossless ? "image/png" : "image/jpeg" });
  let bitmap = null;
  try {
    bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
  } catch {
    say("a picture could not be decoded");
  } finally {
    if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ shown: frame.number }));
  }
  if (frame.number < state.received || socket !== state.socket) return bitmap?.close();
  state.received = frame.number;
  if (!bitmap) return;
  state.wait = BACK_OFF[0];
  const second = frame.number === state.otherAsked;
  if (second) {
    forgetOther();
    state.other = bitmap;
  } else {
    state.shown?.close();
    [state.shown, state.frame] = [bitmap, frame];
  }
  paint();
  report(frame);
  if (!second && twoModels()) sendOther();
}

/** Puts the picture on the canvas; with two models, the other one left of the slider. */
function paint() {
  if (!state.shown) return;
  const { width, height } = state.shown;
  if (picture.width !== width || picture.height !== height) [picture.width, picture.height] = [width, height];
  const context = picture.getContext("2d", { alpha: false, colorSpace: "srgb" });
  context.drawImage(state.shown, 0, 0);
  const share = Number($("split").value) / 100;
  if (twoModels() && state.other?.width === width && state.other.height === height) {
    const part = Math.round(share * width);
    if (part > 0) context.drawImage(state.other, 0, 0, part, height, 0, 0, part, height);
  }
  photo.hidden = !(state.photo >= 0 && share > 0);
  photo.style.clipPath = `inset(0 ${100 - (clipEnd(share) * 100)}% 0 0)`;
}

/** The slider's place as a share of the stage's width: pictures are centred in it. */
function clipEnd(share) {
  const [left, , width] = rectangle(), whole = stage.clientWidth || 1;
  return (left + share * width) / whole;
}

/** The picture's rectangle on the stage: left, top, width, height in CSS pixels. */
function rectangle() {
  const { clientWidth: w, clientHeight: h } = stage;
  const ratio = Math.min(w / picture.width, h / picture.height);
  const [width, height] = [picture.width * ratio, picture.height * ratio];
  return [(w - width) / 2, (h - height) / 2, width, height];
}

function report(frame) {
  const now = performance.now();
  state.times = [...state.times.filter((t) => now - t < 2000), now];
  const rate = state.times.length > 1 ? ((state.times.length - 1) * 1000) / (now - state.times[0]) : 0;
  $("status").textContent = [
    `${frame.size.join(" x ")}, ${(frame.bytes / 1000).toFixed(0)} kB, ${frame.lossless ? "lossless" : "JPEG"}`,
    `${frame.gaussians.toLocaleString("en")} Gaussians${frame.reduced ? " (a quarter, while moving)" : ""}`,
    `${frame.ms.toFixed(1)} ms to draw${rate > 1 ? `, ${rate.toFixed(0)} pictures/s` : ""}`,
    frame.figure === 1 ? `PSNR ${Number.isFinite(frame.value) ? `${frame.value.toFixed(2)} dB` : "infinite"}` : "",
    frame.figure === 2 ? `${frame.value.toFixed(1)} Gaussians a pixel on average` : "",
    frame.iteration ? `iteration ${frame.iteration}` : "", state.scene.device,
  ].filter(Boolean).join("\n");
}

// --- Photos and lines ---------------------------------------------------------------------------------------------------------

/** Goes to a photo's camera; -1 leaves it where it is. */
function choose(n) {
  state.photo = n;
  for (const [i, item] of [...$("list").querySelectorAll("button")].entries()) {
    item.setAttribute("aria-current", String(state.order[i] === n));
  }
  $("split-label").hidden = !(n >= 0 && state.scene.cameras[n].photo) && state.scene.models.length < 2;
  if (n < 0) return paint();
  const camera = state.scene.cameras[n];
  state.camera = new Camera(camera, state.camera.target, state.scene.up);
  if (camera.photo) photo.src = `/photo/${n}`;
  change();
}

function step(by) {
  const { cameras } = state.scene;
  const at = Math.max(0, state.order.indexOf(state.photo));
  if (cameras.length) choose(state.order[(at + (state.photo < 0 ? 0 : by) + cameras.length) % cameras.length]);
}

function list(worstFirst) {
  const { cameras } = state.scene;
  state.order = cameras.map((_, n) => n);
  if (worstFirst) state.order.sort((a, b) => (cameras[a].psnr ?? Infinity) - (cameras[b].psnr ?? Infinity) || a - b);
  $("list").replaceChildren(...state.order.map((n) => {
    const item = document.createElement("li"), button = document.createElement("button");
    const name = document.createElement("span"), score = document.createElement("span");
    name.textContent = cameras[n].name;
    name.className = cameras[n].held_out ? "held-out" : "";
    score.textContent = cameras[n].psnr == null ? "" : cameras[n].psnr.toFixed(2);
    button.title = cameras[n].held_out ? "held out" : "trained on";
    button.append(name, score);
    button.addEventListener("click", () => choose(n));
    item.append(button);
    return item;
  }));
}

function overlay() {
  const ratio = globalThis.devicePixelRatio || 1;
  const [width, height] = [Math.round(stage.clientWidth * ratio), Math.round(stage.clientHeight * ratio)];
  if (lines.width !== width || lines.height !== height) {
    [lines.width, lines.height] = [width, height];
    if (state.camera && state.photo < 0) change();
    paint();
  }
  const context = lines.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  if (!state.camera) return;
  if ($("crop").open) crop(context);
  if (!$("frusta").checked || state.photo >= 0) return;
  draw(context, rectangle(), state.camera, state.scene.cameras, state.paints, state.length, state.photo);
}

/** Shows the sphere that fits into the picture: its outline, and the option that keeps what lies in it. */
function crop(context) {
  const [left, top, width, height] = rectangle();
  context.beginPath();
  context.arc(left + width / 2, top + height / 2, height / 2, 0, 2 * Math.PI);
  context.strokeStyle = "#fff";
  context.stroke();
  // All four to a thousandth of the radius, wherever the centre lies.
  const { sphere } = state.camera, digits = Math.min(20, Math.max(0, 3 - Math.floor(Math.log10(sphere[3]))));
  $("crop").lastElementChild.textContent = `--crop-sphere ${sphere.map((v) => Number(v.toFixed(digits))).join(",")}`;
}

// --- Input -------------------------------------------------------------------------------------------------------------------

/** Keys that are held, and a gamepad. */
function steer(now) {
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

function listen() {
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
    else if (key === "h") $("panel").hidden = !$("panel").hidden;
    else if (/^[1-9]$/.test(key) && Number(key) <= $("kind").options.length) { $("kind").selectedIndex = Number(key) - 1; kind(); }
    else { state.keys.add(key); return; }
    event.preventDefault();
  });
  addEventListener("keyup", (event) => state.keys.delete(event.key.toLowerCase()));
  addEventListener("blur", () => state.keys.clear());
  addEventListener("hashchange", () => restore(location.hash.slice(1)));
  // Keys belong to the camera again.
  $("panel").addEventListener("change", (event) => event.target.blur());
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
  $("pause").addEventListener("click", () => control(state.paused ? "resume" : "pause"));
  $("checkpoint").addEventListener("click", () => control("checkpoint"));
  $("share").addEventListener("change", () => control({ share: Number($("share").value) }));
  $("stop").addEventListener("click", () => { if (confirm(state.scene.checkpoints ? "End the run? It can be resumed." : "End it? No model is written.")) control("stop"); });
}

function kind() {
  state.kind = $("kind").value;
  legend();
  change();
}

function legend() {
  $("legend").textContent = meaning(state.kind, state.scene.models[state.model]?.pruned_by);
}

function home() {
  const { start, target, up } = state.scene;
  if (!start) return;
  choose(-1);
  state.camera = new Camera(start, target, up);
  change();
}

/** The view as text, so that its address can be sent to somebody. */
function fragment() {
  if (state.photo >= 0) return `photo=${state.photo}&kind=${state.kind}`;
  const { position, rotation, fov, distance } = state.camera;
  const numbers = [...position, ...rotation, fov, distance].map((v) => Number(v.toPrecision(9)));
  return `pose=${numbers.join(",")}&kind=${state.kind}`;
}

function restore(text) {
  const given = new URLSearchParams(text);
  if ([...$("kind").options].some((o) => o.value === given.get("kind"))) $("kind").value = state.kind = given.get("kind");
  legend();
  const numbers = (given.get("pose") ?? "").split(",").map(Number);
  if (numbers.length === 9 && numbers.every(Number.isFinite)) {
    const [fov, distance] = numbers.slice(7);
    state.camera = new Camera({ position: numbers.slice(0, 3), rotation: numbers.slice(3, 7), fov }, [0, 0, 0], state.scene.up);
    state.camera.distance = Math.max(distance, 1e-6);
    change();
  }
  const n = Number(given.get("photo") ?? NaN);
  if (Number.isInteger(n) && n >= 0 && n < state.scene.cameras.length) choose(n);
}

// --- Connection -----------------------------------------------------------------------------------------------------------------

function told(text) {
  const news = JSON.parse(text);
  if (news.error ?? news.note) say(news.error ?? news.note);
  if (news.number != null) state.received = Math.max(state.received, news.number); // no picture comes for this one
  if (news.iteration != null) {
    // The model has changed: a picture of it, once the last one has come.
    const old = news.iteration !== state.frame?.iteration;
    if (old && !document.hidden && state.received === state.sent) send(state.stillAsked, state.model);
    $("share").value = String(news.share);
    state.paused = news.paused;
    $("pause").textContent = news.paused ? "Resume" : "Pause";
    const words = [`iteration ${news.iteration} of ${news.until}`, `${news.gaussians.toLocaleString("en")} Gaussians`];
    if (news.loss != null) words.push(`loss ${news.loss.toFixed(4)}`);
    if (news.paused) words.push("paused");
    $("progress").textContent = words.join("\n");
  }
}

function connect() {
  state.received = state.sent; // what was asked for before is lost
  const socket = new WebSocket(`ws://${location.host}/ws`);
  socket.binaryType = "arraybuffer";
  state.socket = socket;
  socket.addEventListener("open", () => {
    say("");
    change();
  });
  socket.addEventListener("message", ({ data }) => {
    if (typeof data === "string") return told(data);
    say("");
    receive(socket, data);
  });
  socket.addEventListener("close", ({ reason }) => {
    say(reason || "no connection to qirf-vk; trying again");
    setTimeout(again, state.wait);
    state.wait = Math.min(2 * state.wait, BACK_OFF[1]);
  });
}

/** Connects again; a program that was started anew has another token, and says so. */
async function again() {
  const answer = await fetch("/scene.json").catch(() => null);
  if (answer?.status === 403) return say(await answer.text());
  connect();
}

async function begin() {
  // The token has become a cookie.
  if (location.search) history.replaceState(null, "", location.pathname + location.hash);
  const answer = await fetch("/scene.json");
  if (!answer.ok) return say(await answer.text());
  const scene = await answer.json();
  Object.assign(state, { scene, paints: colours(scene.cameras), length: frustumLength(scene.cameras) });
  document.title = $("title").textContent = scene.title;
  $("run").hidden = !scene.live;
  for (const id of ["share", "pause", "checkpoint", "stop"]) $(id).disabled = !scene.control;
  $("checkpoint").hidden = !scene.checkpoints;
  $("photos").hidden = scene.cameras.length === 0;
  $("sort").hidden = scene.cameras.every((c) => c.psnr == null);
  if (!scene.models[0]?.pruned_by) for (const option of document.querySelectorAll("#kind .prune")) option.remove();
  $("models-label").hidden = scene.models.length < 2;
  $("models").replaceChildren(...scene.models.map((m, n) => new Option(`${m.name} (${m.gaussians.toLocaleString("en")})`, n)));
  list(false);
  home();
  choose(-1);
  restore(location.hash.slice(1));
  listen();
  connect();
  requestAnimationFrame(tick);
}

begin().catch((error) => say(`the viewer did not start: ${error.message}`));
