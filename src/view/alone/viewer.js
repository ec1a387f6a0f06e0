// Draws the model of this page with WebGL 2: instanced quads, back to front, in halves where the browser has them.

import { Camera, drag, wheeled } from "../camera.js";

const $ = (id) => document.getElementById(id);
const stage = $("stage"), canvas = $("picture"), scene = JSON.parse($("scene").textContent);
/** Turns of the model a second, while it turns by itself. */
const PACE = 0.05;
/** Distances of the target that a second of flying covers. */
const FLIGHT = 1;
/** Near plane without a scene: as a share of the reach, and at most, in world units. */
const NEAR = [0.02, 0.2];

/** Copies the blended picture over the background. */
const FILL = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1); }`;
const COPY = `#version 300 es
precision highp float;
uniform sampler2D blended;
uniform vec3 background;
out vec4 colour;
void main() {
  vec4 sum = texelFetch(blended, ivec2(gl_FragCoord.xy), 0);
  colour = vec4(sum.rgb + (1.0 - sum.a) * background, 1);
}`;

const state = {
  camera: null, n: 0, degree: 0, texels: 0, count: 0, sent: 0, sorted: 0, asked: null, drawn: false, turning: false, now: 0,
  keys: new Set(), pointers: new Map(), ready: false, widthBits: 0,
};
globalThis.viewer = state;

const say = (text) => { $("message").textContent = text; };

// --- WebGL ---------------------------------------------------------------------------------------------------------------

const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" });
let splatting, copying, target, worker;

function program(vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text.trim());
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(made));
  const places = new Map();
  return { made, at: (name) => places.get(name) ?? places.set(name, gl.getUniformLocation(made, name)).get(name) };
}

function upload(unit, words) {
  const width = 2 ** state.widthBits, height = words.length / (4 * width), most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  if (height > most) throw new Error(`its texture of ${width} x ${height} texels is more than this device can hold`);
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, width, height);
  gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, gl.RGBA_INTEGER, gl.UNSIGNED_INT, words);
  if (gl.getError() === gl.OUT_OF_MEMORY) throw new Error("the graphics device has too little memory");
  for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
}

/** A picture in halves of the canvas's size: thousands of layers in bytes would show bands. */
function resize(width, height) {
  if (target?.width === width && target.height === height) return;
  [canvas.width, canvas.height] = [width, height];
  if (target) { gl.deleteTexture(target.texture); gl.deleteFramebuffer(target.frame); }
  target = { width, height, texture: gl.createTexture(), frame: gl.createFramebuffer() };
  gl.activeTexture(gl.TEXTURE2);
  gl.bindTexture(gl.TEXTURE_2D, target.texture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, state.halves ? gl.RGBA16F : gl.RGBA8, width, height);
  for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
  gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target.texture, 0);
}

function start({ splats, bands }) {
  state.halves = Boolean(gl.getExtension("EXT_color_buffer_float") ?? gl.getExtension("EXT_color_buffer_half_float"));
  splatting = program($("vertex").textContent, $("fragment").textContent);
  copying = program(FILL, COPY);
  upload(0, splats);
  upload(1, bands);
  gl.bindVertexArray(gl.createVertexArray());
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.enableVertexAttribArray(0);
  gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
  gl.vertexAttribDivisor(0, 1);
}

/** The camera in the model file's axes, which are ours with y and z the other way. */
function seen() {
  const { camera } = state, flip = ([x, y, z]) => [x, -y, -z];
  return { rows: [camera.right, camera.down, camera.forward].map(flip), centre: flip(camera.position) };
}

function draw() {
  const { width, height } = target, { rows, centre } = seen(), { at } = splatting, { fov, shift, stretch } = state.camera;
  const focal = height / 2 / Math.tan(fov / 2);
  gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
  gl.viewport(0, 0, width, height);
  gl.clearColor(0, 0, 0, 0);
  gl.clear(gl.COLOR_BUFFER_BIT);
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  gl.useProgram(splatting.made);
  gl.uniform1i(at("splats"), 0);
  gl.uniform1i(at("bands"), 1);
  // Columns of the matrix, whose rows are the camera's axes.
  gl.uniformMatrix3fv(at("rotation"), false, [0, 1, 2].flatMap((k) => rows.map((row) => row[k])));
  gl.uniform3fv(at("centre"), centre);
  gl.uniform2f(at("size"), width, height);
  gl.uniform2f(at("focal"), focal * stretch, focal);
  gl.uniform2fv(at("shift"), shift.map((part) => part * height));
  gl.uniform1f(at("near"), state.near);
  gl.uniform1f(at("dilation"), scene.dilation);
  gl.uniform1i(at("antialiased"), scene.antialiased ? 1 : 0);
  gl.uniform1i(at("degree"), state.degree);
  gl.uniform1i(at("texels"), state.texels);
  gl.uniform1i(at("width_bits"), state.widthBits);
  gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, state.count);

  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.disable(gl.BLEND);
  gl.useProgram(copying.made);
  gl.uniform1i(copying.at("blended"), 2);
  gl.uniform3fv(copying.at("background"), scene.background);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}

/** Red, green, blue, alpha of the picture as it is now, lower row first. */
state.pixels = () => {
  draw();
  const bytes = new Uint8Array(4 * canvas.width * canvas.height);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
  return bytes;
};

// --- Frames --------------------------------------------------------------------------------------------------------------

/** Asks for the order of the present camera, unless one is on its way. */
function ask() {
  const { rows: [, , forward], centre } = seen();
  const wish = { forward, offset: forward.reduce((sum, v, k) => sum + v * centre[k], 0), near: state.near };
  const text = JSON.stringify(wish);
  if (text === state.asked || state.sent !== state.sorted) return;
  state.asked = text;
  worker.postMessage({ ...wish, number: ++state.sent });
}

function take({ sorted, number }) {
  gl.bufferData(gl.ARRAY_BUFFER, sorted, gl.DYNAMIC_DRAW);
  [state.count, state.sorted, state.drawn] = [sorted.length, number, false];
  if (!state.ready) say("");
  state.ready = true;
}

/** True once the picture shows the present camera, sorted for it. */
state.settled = () => {
  if (!state.ready || !state.drawn) return false;
  ask();
  return state.sent === state.sorted;
};

function tick(now) {
  const dt = Math.min(0.1, (now - state.now) / 1000);
  state.now = now;
  steer(dt);
  const ratio = Math.min(2, globalThis.devicePixelRatio || 1);
  const size = [stage.clientWidth, stage.clientHeight].map((side) => Math.max(1, Math.round(side * ratio)));
  if (size[0] !== target?.width || size[1] !== target.height) {
    resize(...size);
    if (!state.moved) home();
    state.drawn = false;
  }
  const { position, rotation, shift } = state.camera, pose = `${position} ${rotation} ${shift}`;
  if (pose !== state.pose) [state.pose, state.drawn] = [pose, false];
  ask();
  if (!state.drawn && state.ready && !gl.isContextLost()) {
    draw();
    state.drawn = true;
    $("poster")?.remove();
  }
  requestAnimationFrame(tick);
}

// --- Camera --------------------------------------------------------------------------------------------------------------

/** Height and distance from which the whole fits a picture of this shape, between those worked out for some shapes. */
function framing(aspect) {
  const { framings } = scene, next = framings.findIndex(([a]) => a >= aspect);
  if (next < 0) return framings.at(-1).slice(1);
  // Narrower than all: the width decides.
  if (next === 0) return [framings[0][1], framings[0][2] * (framings[0][0] / aspect)];
  const [low, high] = [framings[next - 1], framings[next]], share = (aspect - low[0]) / (high[0] - low[0]);
  return [1, 2].map((k) => low[k] + share * (high[k] - low[k]));
}

/** Puts the camera at a place: `position`, `rotation` (w, x, y, z), `fov` in radians, `shift` (0, 0 without one), and `stretch` (1 without one). */
state.place = (pose, aim) => {
  state.camera = new Camera(pose, aim ?? scene.centre, scene.up, state.reach);
  state.near = scene.near ?? Math.min(NEAR[1], NEAR[0] * state.reach);
};

/** The camera that the page was made with; without one, the whole model from the front. */
function home() {
  const { centre, up, front, fov, elevation, start } = scene;
  const [height, distance] = framing(stage.clientWidth / Math.max(1, stage.clientHeight));
  state.moved = false;
  state.reach = distance;
  if (start) return state.place(start, scene.target);
  const aim = centre.map((v, k) => v + up[k] * height);
  const level = Math.cos(elevation), above = Math.sin(elevation);
  state.place({ position: aim.map((v, k) => v + (front[k] * level + up[k] * above) * distance), rotation: [1, 0, 0, 0], fov }, aim);
  state.camera.face(aim);
}

function steer(dt) {
  const { keys, camera } = state;
  if (!camera) return;
  const down = (key) => (keys.has(key) ? 1 : 0), fast = dt * FLIGHT * (keys.has("shift") ? 4 : 1);
  const move = [down("d") - down("a"), down("q") - down("e"), down("w") - down("s")];
  const turn = [down("arrowright") - down("arrowleft"), down("arrowup") - down("arrowdown")];
  if (move.some(Boolean)) camera.fly(...move.map((v) => v * fast));
  if (turn.some(Boolean)) camera.orbit(-turn[0] * dt, turn[1] * dt);
  if (state.turning) camera.orbit(2 * Math.PI * PACE * dt, 0);
  if (move.some(Boolean) || turn.some(Boolean) || state.turning) state.moved = true;
}

function dragged(event) {
  if (!state.pointers.has(event.pointerId) || !state.camera) return;
  state.moved = true;
  drag(state.camera, state.pointers, event, stage.clientHeight);
}

function turning(on) {
  state.turning = on;
  $("turn").setAttribute("aria-pressed", String(on));
}

function listen() {
  stage.addEventListener("pointerdown", (event) => {
    stage.setPointerCapture(event.pointerId);
    turning(false);
    state.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, button: event.button });
  });
  stage.addEventListener("pointermove", dragged);
  for (const name of ["pointerup", "pointercancel"]) stage.addEventListener(name, (event) => state.pointers.delete(event.pointerId));
  stage.addEventListener("contextmenu", (event) => event.preventDefault());
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    state.moved = true;
    state.camera.dolly(wheeled(event));
  }, { passive: false });
  const level = () => { state.camera.level(); state.moved = true; };
  const full = () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen?.());
  const keys = {
    home, l: level, " ": () => turning(!state.turning), f: full, h: () => { $("bar").hidden = !$("bar").hidden; },
  };
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches?.("button, summary") && event.key === " ") return;
    const key = event.key.toLowerCase();
    // A key that is held repeats itself, and would turn things on and off.
    if (keys[key]) { if (!event.repeat) keys[key](); }
    else if ("wasdqe".includes(key) || key.startsWith("arrow") || key === "shift") state.keys.add(key);
    else return;
    event.preventDefault();
  });
  addEventListener("keyup", (event) => state.keys.delete(event.key.toLowerCase()));
  addEventListener("blur", () => state.keys.clear());
  $("home").addEventListener("click", home);
  $("level").addEventListener("click", level);
  $("turn").addEventListener("click", () => turning(!state.turning));
  $("full").hidden = !document.fullscreenEnabled; // iPhones have none
  $("full").addEventListener("click", full);
  document.addEventListener("fullscreenchange", () => $("full").setAttribute("aria-pressed", String(Boolean(document.fullscreenElement))));
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault(); // or it never comes back
    say("the graphics device was lost; load the page again");
  });
  canvas.addEventListener("webglcontextrestored", () => location.reload());
}

// --- Beginning -----------------------------------------------------------------------------------------------------------

function begin() {
  if (!gl) return say("this browser has no WebGL 2, which this page needs");
  // The widest textures whose width is a power of two hold the most.
  state.widthBits = 31 - Math.clz32(gl.getParameter(gl.MAX_TEXTURE_SIZE));
  const text = new Blob([$("worker").textContent], { type: "text/javascript" });
  worker = new Worker(URL.createObjectURL(text));
  worker.onmessage = ({ data }) => {
    if (data.fault) return say(`the model cannot be shown: ${data.fault}`);
    if (data.sorted) return take(data);
    Object.assign(state, { n: data.n, degree: data.degree, texels: data.texels });
    try {
      start(data);
    } catch (error) {
      return say(`the model cannot be drawn: ${error.message}`);
    }
    const facts = scene.facts ?? `${data.n.toLocaleString("en")} Gaussian${data.n === 1 ? "" : "s"}`;
    $("facts").textContent = `${facts}, ${scene.made}`;
    listen();
    home();
    requestAnimationFrame(tick);
  };
  worker.onerror = (event) => say(`the model cannot be opened: ${event.message}`);
  worker.postMessage({ model: $("model").textContent, widthBits: state.widthBits });
  $("model").textContent = ""; // the worker has it
}

begin();
