// Perspective projection of one Gaussian to the image plane (EWA splatting), shared by the forward and backward passes.
#include "lib/finite.glsl"

/// A quaternion whose largest component is smaller than this is not a rotation, and its Gaussian is culled.
const float MIN_QUATERNION = 1e-6;
/// Floor of det0 / det under the root of the anti-aliasing factor, which keeps its slope finite.
const float MIN_ANTIALIAS = 2.5e-5;

const float LOG2_E = 1.4426950408889634;

struct Projection {
    bool there;      // in front of the near plane, with a valid rotation and a finite covariance
    vec3 direction;  // unit vector from the camera to the mean, world axes
    vec2 mean;       // pixels from the view's origin
    float depth;
    vec3 covariance; // a, b, c with the dilation, square pixels
    float det0;      // determinant without the dilation, times shrink^4
    float det;       // with it, times shrink^4
    float shrink;    // 1, or small enough that products of four lengths stay within float32 for a Gaussian of any size
    // Intermediate results that the backward pass needs.
    vec3 position;   // camera axes
    vec2 slope;      // x/z and y/z, clamped
    mat3 rotation;
    vec3 scale;
    vec3 row_x;      // Jacobian times scaled axes
    vec3 row_y;
    vec3 normal;     // their cross product, times shrink^2
    vec4 unit;       // quaternion, normalised
    float norm;      // of the stored one
};

// Rotation matrix of a quaternion (w, x, y, z) of any length; false if it is not a rotation. It is first divided by its
// largest component, since the squares of extreme ones leave float32's range.
bool rotation_of(vec4 stored, out mat3 r, out vec4 q, out float norm) {
    float largest = max(max(abs(stored.x), abs(stored.y)), max(abs(stored.z), abs(stored.w)));
    if (!finite(stored) || largest < MIN_QUATERNION) return false;
    q = stored / largest;
    float root = sqrt(dot(q, q));
    norm = largest * root;
    q = q / root;
    float w = q.x, x = q.y, y = q.z, z = q.w;
    r = transpose(mat3(
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)));
    return true;
}

const float LARGE = 1e16;                      // square pixels
const float SHRINK = 2.3283064365386963e-10;   // 2^-32: rounds nothing

Projection project(View v, vec3 mean, vec3 log_scale, vec4 quaternion) {
    Projection p;
    p.there = false;
    mat3 camera = world_to_camera(v);
    vec3 offset = from_centre(v, mean);
    vec3 t = camera * offset;
    if (!finite(t) || !finite(log_scale) || t.z <= v.centre.w || !rotation_of(quaternion, p.rotation, p.unit, p.norm)) return p;

    vec2 clamped = clamp(t.xy / t.z, least_slope(v), most_slope(v));
    // Rows of the Jacobian times the rotated axes: the covariance then consists of dot products, and its determinant is
    // the square of a cross product, which cannot become negative.
    mat3 axes = camera * p.rotation;
    p.scale = exp(log_scale);
    vec2 f = v.focal / t.z;
    vec3 row_x = f.x * (vec3(axes[0].x, axes[1].x, axes[2].x) - clamped.x * vec3(axes[0].z, axes[1].z, axes[2].z)) * p.scale;
    vec3 row_y = f.y * (vec3(axes[0].y, axes[1].y, axes[2].y) - clamped.y * vec3(axes[0].z, axes[1].z, axes[2].z)) * p.scale;
    float a0 = dot(row_x, row_x), c0 = dot(row_y, row_y);
    p.shrink = a0 + c0 > LARGE ? SHRINK : 1.0;
    float shrunk = v.dilation * p.shrink * p.shrink;
    p.normal = cross(row_x * p.shrink, row_y * p.shrink);
    p.covariance = vec3(a0 + v.dilation, dot(row_x, row_y), c0 + v.dilation);
    p.det0 = dot(p.normal, p.normal);
    p.det = p.det0 + shrunk * ((a0 + c0) * p.shrink * p.shrink) + shrunk * shrunk;
    p.mean = v.focal * (t.xy / t.z) + v.principal;
    p.depth = t.z;
    p.position = t;
    p.slope = clamped;
    p.row_x = row_x;
    p.row_y = row_y;
    p.direction = normalize(offset);
    p.there = finite(vec3(p.det, a0, c0)) && p.det > 0;
    return p;
}

// The factor k of lib/splat.glsl.
vec3 splat_factor(Projection p) {
    float root = sqrt(0.5 * LOG2_E);
    float c = p.covariance.z;
    float along = root * p.shrink * sqrt(c * p.shrink * p.shrink / p.det);
    return vec3(along, -(p.covariance.y / c) * along, root / sqrt(c));
}
