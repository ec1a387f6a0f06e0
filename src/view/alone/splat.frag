#version 300 es
precision highp float;
in vec2 place;
flat in vec4 paint;
out vec4 colour;

void main() {
  float power = dot(place, place);
  float alpha = min(0.99, exp2(paint.w - power));
  if (alpha < 1.0 / 255.0) discard;
  colour = vec4(paint.rgb * alpha, alpha);
}
