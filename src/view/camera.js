// A camera that orbits, pans and flies. Rotations are quaternions [w, x, y, z] from camera (x right, y down, z forward) to world.

export const add = (a, b) => a.map((v, i) => v + b[i]);
export const scaled = (a, s) => a.map((v) => v * s);
export const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
export const less = (a, b) => add(a, scaled(b, -1));
export const length = (a) => Math.sqrt(dot(a, a));
export const cross = ([a, b, c], [d, e, f]) => [b * f - c * e, c * d - a * f, a * e - b * d];
export const unit = (a) => scaled(a, 1 / (length(a) || 1));

const times = ([a, b, c, d], [e, f, g, h]) => [
  a * e - b * f - c * g - d * h, a * f + b * e + c * h - d * g, a * g - b * h + c * e + d * f, a * h + b * g - c * f + d * e,
];

/** A vector turned by a rotation. */
export function turned(q, v) {
  const t = scaled(cross(q.slice(1), v), 2);
  return add(add(v, scaled(t, q[0])), cross(q.slice(1), t));
}

/** A vector turned back. */
export const turnedBack = ([w, x, y, z], v) => turned([w, -x, -y, -z], v);

const about = (axis, angle) => [Math.cos(angle / 2), ...scaled(unit(axis), Math.sin(angle / 2))];

/** The rotation whose camera looks along `forward` with `up` upwards. */
function looking(forward, up) {
  const z = unit(forward), x = unit(cross(z, up)), y = cross(z, x);
  const trace = x[0] + y[1] + z[2];
  const q = [1 + trace, y[2] - z[1], z[0] - x[2], x[1] - y[0]];
  if (length(q) > 1e-3) return unit(q);
  // Half a turn: the largest diagonal entry names the axis.
  const axis = [x[0], y[1], z[2]].indexOf(Math.max(x[0], y[1], z[2]));
  return [[0, 1 + x[0], x[1], x[2]], [0, y[0], 1 + y[1], y[2]], [0, z[0], z[1], 1 + z[2]]].map(unit)[axis];
}

/** Smallest angle between the view direction and the poles of an orbit, in radians. */
const POLE = 0.02;

export class Camera {
  /**
   * `shift`: the principal point, where the target appears, from the picture's middle, to the right and down, in heights of the picture.
   * `stretch`: the horizontal focal length over the vertical one.
   * `reach`, the distance from which one sees the whole, bounds zooming and keeps flights from stopping; 0 if it is not known.
   */
  constructor({ position, rotation, fov, shift = [0, 0], stretch = 1 }, target, up, reach = 0) {
    Object.assign(this, { position, rotation: unit(rotation), fov, shift, stretch, up: unit(up), reach });
    this.distance = Math.max(length(less(target, position)), 1e-6);
  }

  get right() { return turned(this.rotation, [1, 0, 0]); }
  get down() { return turned(this.rotation, [0, 1, 0]); }
  get forward() { return turned(this.rotation, [0, 0, 1]); }
  get target() { return add(this.position, scaled(this.forward, this.distance)); }

  /** A turn to the left about `up` and upwards about the camera's right, in radians, that passes no pole. */
  turn(yaw, pitch) {
    const above = Math.asin(Math.max(-1, Math.min(1, dot(this.forward, this.up))));
    const most = Math.PI / 2 - POLE;
    // Beyond the limit, as a photo's camera may be, it can only turn back.
    const allowed = Math.max(Math.min(0, -most - above), Math.min(Math.max(0, most - above), pitch));
    return times(about(this.up, yaw), about(this.right, allowed));
  }

  /** Turns round the target: what lies before it moves right and down. */
  orbit(dx, dy) {
    const target = this.target;
    this.rotation = unit(times(this.turn(-dx, -dy), this.rotation));
    this.position = less(target, scaled(this.forward, this.distance));
  }

  /** Turns on the spot, to the right and upwards. */
  look(right, up) { this.rotation = unit(times(this.turn(-right, up), this.rotation)); }

  /** Moves by shares of the picture's height at the target's distance. */
  pan(dx, dy) {
    const height = 2 * this.distance * Math.tan(this.fov / 2);
    this.position = add(this.position, add(scaled(this.right, (-dx * height) / this.stretch), scaled(this.down, -dy * height)));
  }

  /** Multiplies the distance from the target, between a thousandth of the reach and a thousand times as much. */
  dolly(factor) {
    const target = this.target, most = 1e3 * this.reach || Infinity;
    this.distance = Math.max(Math.min(this.distance * factor, most), 1e-3 * this.reach, 1e-6);
    this.position = less(target, scaled(this.forward, this.distance));
  }

  /** Moves along its axes, in target distances, or in twentieths of the reach where these are longer. */
  fly(right, down, forward) {
    const step = add(add(scaled(this.right, right), scaled(this.down, down)), scaled(this.forward, forward));
    this.position = add(this.position, scaled(step, Math.max(this.distance, 0.05 * this.reach)));
  }

  /** Looks at a point, round which it then turns. */
  face(point) {
    const way = less(point, this.position);
    this.distance = Math.max(length(way), 1e-6);
    this.rotation = looking(way, this.up);
  }

  /** Radius of the circle about the target that fits into a picture of this ratio of width to height, in heights of the picture. */
  room(ratio) { return Math.max(0, Math.min(0.5 - Math.abs(this.shift[1]), (0.5 * ratio - Math.abs(this.shift[0])) / this.stretch)); }

  /** The sphere that this circle outlines: x, y, z, radius. */
  sphere(ratio) { return [...this.target, this.distance * Math.sin(Math.atan(2 * Math.tan(this.fov / 2) * this.room(ratio)))]; }

  /** Puts the horizon level. */
  level() { if (length(cross(this.forward, this.up)) > 1e-3) this.rotation = looking(this.forward, this.up); }

  /** The pixel and depth of a point in a picture of this size; null behind the camera. */
  project(point, [width, height]) {
    const [x, y, z] = turnedBack(this.rotation, less(point, this.position));
    if (z < 1e-4 * this.distance) return null;
    const focal = height / 2 / Math.tan(this.fov / 2), [right, down] = scaled(this.shift, height);
    return [width / 2 + right + (focal * this.stretch * x) / z, height / 2 + down + (focal * y) / z, z];
  }
}

const spread = (pointers) => { const [a, b] = [...pointers.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };

/**
 * Moves a held pointer, and the camera with it, in a picture of this height: one pointer orbits, pans (another button, or shift) or looks
 * round (control or command); two pan and pinch.
 */
export function drag(camera, pointers, event, height) {
  const before = pointers.get(event.pointerId), two = pointers.size === 2, apart = two ? spread(pointers) : 0;
  const [dx, dy] = [(event.clientX - before.x) / height, (event.clientY - before.y) / height];
  pointers.set(event.pointerId, { ...before, x: event.clientX, y: event.clientY });
  if (two) {
    camera.dolly(apart / Math.max(spread(pointers), 1));
    camera.pan(dx / 2, dy / 2);
  } else if (before.button > 0 || event.shiftKey) camera.pan(dx, dy);
  else if (event.ctrlKey || event.metaKey) camera.look(-dx * camera.fov, dy * camera.fov);
  else camera.orbit(dx * Math.PI, dy * Math.PI);
}

/** The factor of the target's distance for a turn of the wheel, in pixels or lines. */
export const wheeled = (event) => Math.exp(Math.max(-1, Math.min(1, event.deltaY * (event.deltaMode ? 0.05 : 0.0015))));
