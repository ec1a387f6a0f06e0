// Lines over the picture: the photos' cameras, and the axes at the target; and what the picture's colours mean.

import { add, length, less, scaled, turned } from "./camera.js";

/** Distance in pixels within which a click hits a camera. */
const REACH = 14;

/** What the colours of a picture mean. */
const MEANINGS = {
  depth: "blue: near, red: far",
  error: "blue: no difference, red: 0.25",
  count: "blue: no Gaussians, green: 15, red: 255 or more",
  kept: "green: kept, yellow: merged into a kept one, red: dropped",
  score: "rank by score: blue lowest, red highest",
  participation: "rank in participation: blue lowest, red highest",
  guards:
    "blue: seen by no view, orange: metric not positive definite, pink: numbers not finite, cyan: kept for its detail, grey: none of these",
};

/** What the colours of a picture mean, of a model that was pruned by a selector or not at all. */
export function meaning(kind, by) {
  const blocks = by === "pairs" ? "a colour for each cluster that became one Gaussian" : `a colour for each block that ${by} chose from`;
  return kind === "blocks" && by ? blocks : MEANINGS[kind] ?? "";
}

const scale = (share) => `hsl(${Math.round(120 * Math.max(0, Math.min(1, share)))} 85% 60%)`;

/** Length of a drawn camera: a share of the cameras' typical distance from their middle. */
export function frustumLength(cameras) {
  const middle = scaled(cameras.reduce((sum, c) => add(sum, c.position), [0, 0, 0]), 1 / Math.max(1, cameras.length));
  const distances = cameras.map((c) => length(less(c.position, middle))).sort((a, b) => a - b);
  return 0.06 * (distances[distances.length >> 1] || 1);
}

/** Colours of cameras: by PSNR where it is known, else grey; held-out ones without a score blue. */
export function colours(cameras) {
  const known = cameras.map((c) => c.psnr).filter((p) => p != null);
  const low = Math.min(...known), range = Math.max(...known) - low || 1;
  return cameras.map((c) => (c.psnr != null ? scale((c.psnr - low) / range) : c.held_out ? "#7fb0ff" : "#8a94a3"));
}

/** The point at (x, y) of a camera's drawn picture, which reaches from -1 to 1 in both. */
function inPicture(c, [x, y], size) {
  const half = Math.tan(c.fov / 2), wide = (half * c.size[0]) / c.size[1], [right, down] = scaled(c.shift, 2 * half);
  return add(c.position, turned(c.rotation, scaled([(x * wide - right) / c.stretch, y * half - down, 1], size)));
}

/** Draws cameras and axes in the rectangle [x, y, width, height] of the canvas. */
export function draw(context, [left, top, width, height], camera, cameras, paints, size, chosen) {
  const line = (points, paint, thick = 1) => {
    const pixels = points.map((p) => camera.project(p, [width, height]));
    if (pixels.includes(null)) return;
    context.beginPath();
    pixels.forEach(([x, y], i) => context[i ? "lineTo" : "moveTo"](left + x, top + y));
    context.strokeStyle = paint;
    context.lineWidth = thick;
    context.stroke();
  };
  cameras.forEach((c, n) => {
    const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map((at) => inPicture(c, at, size));
    const thick = n === chosen ? 2.5 : 1;
    line([...corners, corners[0]], paints[n], thick);
    corners.forEach((p) => line([c.position, p], paints[n], thick));
  });
  const target = camera.target, reach = 0.08 * camera.distance;
  [["#f06a6a", [1, 0, 0]], ["#6ad08a", [0, 1, 0]], ["#6aa0f0", [0, 0, 1]]].forEach(([paint, axis]) =>
    line([target, add(target, scaled(axis, reach))], paint, 1.5));
}

/** The camera whose place or drawn picture's middle is at a pixel; -1 for none. */
export function hit([x, y], [left, top, width, height], camera, cameras, size) {
  let best = -1, nearest = REACH;
  cameras.forEach((c, n) => {
    for (const point of [c.position, inPicture(c, [0, 0], size)]) {
      const pixel = camera.project(point, [width, height]);
      const distance = pixel ? Math.hypot(left + pixel[0] - x, top + pixel[1] - y) : Infinity;
      if (distance < nearest) [best, nearest] = [n, distance];
    }
  });
  return best;
}
