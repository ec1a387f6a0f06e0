#version 450
// A kernel of your own: takes the colour out of a picture.

layout(local_size_x = 64) in;

layout(std430, binding = 0) buffer Pixels {
    vec4 pixels[]; // red, green, blue, alpha
};
layout(push_constant) uniform Push {
    uint count;
    float amount; // 0 changes nothing, 1 leaves grey
};

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i < count) {
        vec4 pixel = pixels[i];
        float luminance = dot(pixel.rgb, vec3(0.2126, 0.7152, 0.0722));
        pixels[i] = vec4(mix(pixel.rgb, vec3(luminance), amount), pixel.a);
    }
}
