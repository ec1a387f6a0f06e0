// The viewer's page: asks for pictures over one WebSocket and shows them. Moving pictures are JPEG, still ones lossless.

import { Camera, length, less, scaled } from "./camera.js";
import { colours, draw, frustumLength } from "./draw.js";
import { fragment, home, listen, restore, steer } from "./input.js";

/** Milliseconds without a movement after which the picture counts as still. */
const REST = 150;
/** Milliseconds before the first attempt to connect again, and at most. */
const BACK_OFF = [500, 5000];
const HEADER = 32;
/** Milliseconds for which a note stays, whatever pictures come. */
const NOTED = 5000;
/** What steers a run. */
const STEERING = ["share", "pause", "checkpoint", "stop"];

export const $ = (id) => document.getElementById(id);
export const stage = $("stage");
const picture = $("picture"), photo = $("photo"), lines = $("lines");

export const state = {
  scene: null, camera: null, photo: -1, model: 0, kind: "colour",
  sent: 0, received: 0, request: null, otherAsked: 0, changed: false, lastChange: 0, stillAsked: true, other: null, shown: null,
  keys: new Set(), pointers: new Map(), socket: null, wait: BACK_OFF[0], times: [], reach: 0, noted: 0, ended: "",
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

export const twoModels = () => state.scene.models.length > 1 && Number($("split").value) > 0 && state.photo < 0;

function send(still, model) {
  if (state.socket?.readyState !== WebSocket.OPEN || !state.camera) return;
  const { position, rotation, fov, shift, stretch } = state.camera;
  const grey = $("background").value;
  const request = {
    number: ++state.sent, size: size(), picture: state.kind, model, degree: Number($("degree").value), still,
    camera: state.photo >= 0 ? { photo: state.photo } : { pose: { position, rotation, fov, shift, stretch } },
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
export function change(leave = false) {
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
export function paint() {
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
export function rectangle() {
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
    frame.figure === 2 ? `${frame.value.toFixed(1)} Gaussians per pixel on average` : "",
    frame.iteration ? `iteration ${frame.iteration}` : "", state.scene.device,
  ].filter(Boolean).join("\n");
}

// --- Photos and lines ---------------------------------------------------------------------------------------------------------

/** Goes to a photo's camera; -1 leaves it where it is. */
export function choose(n) {
  state.photo = n;
  for (const [i, item] of [...$("list").querySelectorAll("button")].entries()) {
    item.setAttribute("aria-current", String(state.order[i] === n));
  }
  $("split-label").hidden = !(n >= 0 && state.scene.cameras[n].photo) && state.scene.models.length < 2;
  if (n < 0) return paint();
  const camera = state.scene.cameras[n];
  state.camera = new Camera(camera, state.camera.target, state.scene.up, state.reach);
  if (camera.photo) Object.assign(photo, { src: `/photo/${n}`, alt: camera.name });
  change();
}

export function step(by) {
  const { cameras } = state.scene;
  const at = Math.max(0, state.order.indexOf(state.photo));
  if (cameras.length) choose(state.order[(at + (state.photo < 0 ? 0 : by) + cameras.length) % cameras.length]);
}

export function list(worstFirst) {
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
    button.setAttribute("aria-current", String(n === state.photo));
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

/** A sphere of the page in the coordinates of the shown model's file. */
function inFile([x, y, z, radius]) {
  const { unit, models } = state.scene;
  return [...less(scaled([x, y, z], unit), models[state.model]?.shift ?? [0, 0, 0]), unit * radius];
}

/** Shows the sphere that fits into the picture: its outline, and the option that keeps what lies in it; nothing if none fits. */
function crop(context) {
  const [left, top, width, height] = rectangle(), { camera } = state, ratio = picture.width / picture.height;
  const [right, down] = scaled(camera.shift, height), room = camera.room(ratio), option = $("crop").lastElementChild;
  if (room === 0) {
    option.textContent = "";
    return;
  }
  context.beginPath();
  context.ellipse(left + width / 2 + right, top + height / 2 + down, room * height * camera.stretch, room * height, 0, 0, 2 * Math.PI);
  context.strokeStyle = "#fff";
  context.stroke();
  // All four to a thousandth of the radius, wherever the centre lies.
  const sphere = inFile(camera.sphere(ratio));
  const digits = Math.min(20, Math.max(0, 3 - Math.floor(Math.log10(sphere[3]))));
  option.textContent = `--crop-sphere ${sphere.map((v) => Number(v.toFixed(digits))).join(",")}`;
}

// --- Connection -----------------------------------------------------------------------------------------------------------------

/** Shows whether the run is paused. */
export function paused(is) {
  state.paused = is;
  $("pause").textContent = is ? "Resume" : "Pause";
}

function told(text) {
  const news = JSON.parse(text);
  if (news.error ?? news.note) say(news.error ?? news.note);
  if (news.note) state.noted = performance.now() + NOTED;
  if (news.ended) state.ended = news.ended;
  if (news.number != null) state.received = Math.max(state.received, news.number); // no picture comes for this one
  if (news.iteration != null) {
    // The model has changed: a picture of it, once the last one has come.
    const old = news.iteration !== state.frame?.iteration;
    if (old && !document.hidden && state.received === state.sent) send(state.stillAsked, state.model);
    $("share").value = String(news.share);
    paused(news.paused);
    const words = [`iteration ${news.iteration} of ${news.until}`, `${news.gaussians.toLocaleString("en")} Gaussians`];
    if (news.loss != null) words.push(`loss ${news.loss.toFixed(4)}`);
    if (news.paused) words.push("paused");
    $("progress").textContent = words.join("\n");
  }
}

/** Whether the run can be steered. */
function steering(can) {
  for (const id of STEERING) $(id).disabled = !can;
}

function connect() {
  state.received = state.sent; // what was asked for before is lost
  const socket = new WebSocket(`ws://${location.host}/ws`);
  socket.binaryType = "arraybuffer";
  state.socket = socket;
  socket.addEventListener("open", () => {
    state.ended = "";
    steering(state.scene.control);
    say(state.scene?.live && !state.frame ? "waiting for the first iteration" : "");
    change();
  });
  socket.addEventListener("message", ({ data }) => {
    if (typeof data === "string") return told(data);
    if (performance.now() > state.noted) say("");
    receive(socket, data);
  });
  socket.addEventListener("close", ({ reason }) => {
    // Later attempts to connect have no reason: the first one stays.
    state.ended ||= reason;
    say(state.ended || "no connection to qirf-vk; trying again");
    steering(false);
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

/** Offers the SH degrees that the models have; a model in training may still get more. */
function degrees() {
  const { models } = state.scene;
  if (models.length === 0) return;
  const most = Math.max(...models.map((m) => m.degree));
  $("degree").replaceChildren(...Array.from({ length: most + 1 }, (_, k) => new Option(most - k)));
  $("degree").disabled = most === 0;
}

async function begin() {
  // The token has become a cookie.
  if (location.search) history.replaceState(null, "", location.pathname + location.hash);
  const answer = await fetch("/scene.json");
  if (!answer.ok) return say(await answer.text());
  const scene = await answer.json();
  const reach = scene.start ? length(less(scene.start.position, scene.target)) : 0;
  Object.assign(state, { scene, reach, paints: colours(scene.cameras), length: frustumLength(scene.cameras) });
  document.title = $("title").textContent = scene.title;
  $("run").hidden = !scene.live;
  steering(scene.control);
  $("checkpoint").hidden = !scene.checkpoints;
  $("photos").hidden = scene.cameras.length === 0;
  $("sort").hidden = scene.cameras.every((c) => c.psnr == null);
  const { pruned_by: pruned, participation } = scene.models[0] ?? {};
  for (const option of document.querySelectorAll("#kind .prune")) {
    if (!pruned || (option.value === "participation" && !participation)) option.remove();
  }
  if (scene.cameras.length === 0 && scene.models.length < 2) document.querySelector("#kind [value=error]").remove();
  $("models-label").hidden = scene.models.length < 2;
  $("models").replaceChildren(...scene.models.map((m, n) => new Option(`${m.name} (${m.gaussians.toLocaleString("en")})`, n)));
  degrees();
  list(false);
  home();
  choose(-1);
  restore(location.hash.slice(1));
  listen();
  connect();
  requestAnimationFrame(tick);
}

begin().catch((error) => say(`the viewer did not start: ${error.message}`));
