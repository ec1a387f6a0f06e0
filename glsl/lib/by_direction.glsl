// The gradient of a Gaussian's colour by its view direction. Includers declare DEGREE, view[], and sh1[] to sh3[].

vec3 sh_at(uint band, uint at) {
    return band == 1 ? vec3(sh1[at], sh1[at + 1], sh1[at + 2])
         : band == 2 ? vec3(sh2[at], sh2[at + 1], sh2[at + 2]) : vec3(sh3[at], sh3[at + 1], sh3[at + 2]);
}

// The gradient by the view direction d of Gaussian i, from that by its colour.
vec3 gradient_by_direction(uint i, vec3 d, vec3 by_colour) {
    vec3 sum = vec3(0);
    if (DEGREE > 0 && view[0].degree > 0) {
        float g[3];
        [[unroll]] for (uint m = 0; m < 3; m++) g[m] = dot(by_colour, sh_at(1, 9 * i + 3 * m));
        sum += sh_gradient_1(g);
    }
    if (DEGREE > 1 && view[0].degree > 1) {
        float g[5];
        [[unroll]] for (uint m = 0; m < 5; m++) g[m] = dot(by_colour, sh_at(2, 15 * i + 3 * m));
        sum += sh_gradient_2(d, g);
    }
    if (DEGREE > 2 && view[0].degree > 2) {
        float g[7];
        [[unroll]] for (uint m = 0; m < 7; m++) g[m] = dot(by_colour, sh_at(3, 21 * i + 3 * m));
        sum += sh_gradient_3(d, g);
    }
    return sum;
}
