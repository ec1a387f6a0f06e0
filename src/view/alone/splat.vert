#version 300 es
// One corner of a Gaussian's quad. The model is SPZ's bytes, and is unpacked here; projection and colour are those of qirf-vk.
precision highp float;
precision highp int;
precision highp usampler2D;

uniform usampler2D splats, bands;
uniform mat3 rotation;  // from the file's axes to the camera's
uniform vec3 centre;    // of the camera, in the file's axes
uniform vec2 size, focal, shift; // shift: the principal point from the picture's middle, in pixels
uniform float near, dilation;
uniform bool antialiased;
uniform int degree, texels, width_bits;

layout(location = 0) in uint index;

out vec2 place;      // in units in which density falls by 2^-(place . place)
flat out vec4 paint; // colour, and log2 of opacity

// FIELD_MARGIN and FIELD_BEYOND of the renderer's kernels.
const float MARGIN = 1.3, BEYOND = 1.2;
const float ROOT_HALF = 0.7071067811865476, LOG2_E = 1.4426950408889634;
const float SH_C0 = 0.28209479177387814, SH_C1 = 0.4886025119029199;
const float XY = 1.0925484305920792, ZZ = 0.31539156525252005, XX = 0.5462742152960396;
const float XXX = 0.5900435899266435, XYZ = 2.890611442640554, XZZ = 0.4570457994644658, ZZZ = 0.3731763325901154, XXZ = 1.445305721320277;

uvec4 texel(usampler2D from, uint at) { return texelFetch(from, ivec2(at & ((1u << width_bits) - 1u), at >> width_bits), 0); }

vec3 bytes(uint word) { return vec3(uvec3(word, word >> 8, word >> 16) & 255u); }

// The three smaller components over +-sqrt(1/2), and in the top bits which one of x, y, z, w is the greatest.
vec4 quaternion(uint word) {
  vec3 smaller;
  for (int k = 0; k < 3; k++) {
    uint bits = word >> (20 - 10 * k);
    smaller[k] = float(bits & 511u) / 511.0 * ROOT_HALF * ((bits & 512u) == 0u ? 1.0 : -1.0);
  }
  float greatest = sqrt(max(0.0, 1.0 - dot(smaller, smaller)));
  uint at = word >> 30;
  return at == 0u ? vec4(greatest, smaller) : at == 1u ? vec4(smaller.x, greatest, smaller.yz)
    : at == 2u ? vec4(smaller.xy, greatest, smaller.z) : vec4(smaller, greatest);
}

mat3 turn(vec4 q) {
  float x = q.x, y = q.y, z = q.z, w = q.w;
  return transpose(mat3(
    1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
    2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
    2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)));
}

vec3 radiance(vec3 stored, vec3 d) {
  vec3 sum = SH_C0 * (stored / 255.0 - 0.5) / 0.15;
  if (degree == 0) return sum;
  float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  float basis[15] = float[](
    -SH_C1 * y, SH_C1 * z, -SH_C1 * x,
    XY * x * y, -XY * y * z, ZZ * (2.0 * zz - xx - yy), -XY * x * z, XX * (xx - yy),
    -XXX * y * (3.0 * xx - yy), XYZ * x * y * z, -XZZ * y * (4.0 * zz - xx - yy), ZZZ * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
    -XZZ * x * (4.0 * zz - xx - yy), XXZ * z * (xx - yy), -XXX * x * (xx - 3.0 * yy));
  int count = (degree + 1) * (degree + 1) - 1;
  uint start = index * uint(texels);
  uvec4 words[3];
  words[0] = texel(bands, start);
  words[1] = texels > 1 ? texel(bands, start + 1u) : uvec4(0);
  words[2] = texels > 2 ? texel(bands, start + 2u) : uvec4(0);
  for (int k = 0; k < 15; k++) {
    if (k >= count) break;
    vec3 value;
    for (int c = 0; c < 3; c++) {
      int at = 3 * k + c;
      value[c] = float(words[at >> 4][(at >> 2) & 3] >> uint(8 * (at & 3)) & 255u);
    }
    sum += basis[k] * (value - 128.0) / 128.0;
  }
  return sum;
}

void main() {
  gl_Position = vec4(0, 0, 2, 1); // outside, unless all goes well
  place = vec2(0);
  paint = vec4(0);
  uvec4 first = texel(splats, 2u * index), second = texel(splats, 2u * index + 1u);
  vec3 offset = uintBitsToFloat(first.xyz) - centre;
  vec3 t = rotation * offset;
  if (t.z <= near) return;

  vec2 middle = -shift / focal, field = 0.5 * size / focal;
  vec2 slope = clamp(t.xy / t.z, min(-MARGIN * field, middle - BEYOND * field), max(MARGIN * field, middle + BEYOND * field));
  mat3 axes = rotation * turn(quaternion(first.w));
  vec3 scale = exp(bytes(second.y) / 16.0 - 10.0);
  vec2 f = focal / t.z;
  vec3 below = vec3(axes[0].z, axes[1].z, axes[2].z);
  vec3 row_x = f.x * (vec3(axes[0].x, axes[1].x, axes[2].x) - slope.x * below) * scale;
  vec3 row_y = f.y * (vec3(axes[0].y, axes[1].y, axes[2].y) - slope.y * below) * scale;
  float a0 = dot(row_x, row_x), c0 = dot(row_y, row_y), b = dot(row_x, row_y);
  vec3 normal = cross(row_x, row_y);
  float det0 = dot(normal, normal), c = c0 + dilation;
  float det = det0 + dilation * (a0 + c0) + dilation * dilation;

  float opacity = float(second.x >> 24) / 255.0;
  if (antialiased) opacity *= sqrt(max(det0 / det, 2.5e-5));
  float cut = log2(255.0 * opacity);
  if (!(cut > 0.0) || !(det > 0.0)) return;

  float root = sqrt(0.5 * LOG2_E), along = root * sqrt(c / det);
  vec3 k = vec3(along, -(b / c) * along, root / sqrt(c));
  vec2 mean = f * t.xy + shift;
  // The parallelogram round the ellipse at which alpha falls to 1/255.
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  place = corner * sqrt(cut);
  float down = place.y / k.z;
  vec2 pixel = mean + vec2((place.x - k.y * down) / k.x, down);
  vec2 reach = vec2(sqrt(cut * (a0 + dilation)), sqrt(cut * c)) / root;
  if (any(greaterThan(abs(mean) - reach, 0.5 * size))) return;
  gl_Position = vec4(2.0 * pixel / size * vec2(1, -1), 0, 1);
  paint = vec4(max(vec3(0), radiance(bytes(second.x), normalize(offset)) + 0.5), log2(opacity));
}
