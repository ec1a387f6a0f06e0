// Real spherical harmonics as 3DGS uses them, to degree 3.

/// Y_0, which is also the factor between a band-0 coefficient and a colour: 1 / (2 sqrt(pi)).
const float SH_C0 = 0.28209479177387814;
/// Factor of band 1: sqrt(3 / pi) / 2.
const float SH_C1 = 0.4886025119029199;
/// Factor of xy, yz and xz in band 2: sqrt(15 / pi) / 2.
const float SH_C2_XY = 1.0925484305920792;
/// Factor of 2 zz - xx - yy in band 2: sqrt(5 / pi) / 4.
const float SH_C2_ZZ = 0.31539156525252005;
/// Factor of xx - yy in band 2: sqrt(15 / pi) / 4.
const float SH_C2_XX = 0.5462742152960396;
/// Factor of y (3 xx - yy) and x (xx - 3 yy) in band 3: sqrt(70 / pi) / 8.
const float SH_C3_XXX = 0.5900435899266435;
/// Factor of xyz in band 3: sqrt(105 / pi) / 2.
const float SH_C3_XYZ = 2.890611442640554;
/// Factor of y (4 zz - xx - yy) and x (4 zz - xx - yy) in band 3: sqrt(42 / pi) / 8.
const float SH_C3_XZZ = 0.4570457994644658;
/// Factor of z (2 zz - 3 xx - 3 yy) in band 3: sqrt(7 / pi) / 4.
const float SH_C3_ZZZ = 0.3731763325901154;
/// Factor of z (xx - yy) in band 3: sqrt(105 / pi) / 4.
const float SH_C3_XXZ = 1.445305721320277;

void sh_basis_1(vec3 d, out float b[3]) {
    b[0] = -SH_C1 * d.y;
    b[1] = SH_C1 * d.z;
    b[2] = -SH_C1 * d.x;
}

void sh_basis_2(vec3 d, out float b[5]) {
    b[0] = SH_C2_XY * d.x * d.y;
    b[1] = -SH_C2_XY * d.y * d.z;
    b[2] = SH_C2_ZZ * (2 * d.z * d.z - d.x * d.x - d.y * d.y);
    b[3] = -SH_C2_XY * d.x * d.z;
    b[4] = SH_C2_XX * (d.x * d.x - d.y * d.y);
}

void sh_basis_3(vec3 d, out float b[7]) {
    float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z;
    b[0] = -SH_C3_XXX * d.y * (3 * xx - yy);
    b[1] = SH_C3_XYZ * d.x * d.y * d.z;
    b[2] = -SH_C3_XZZ * d.y * (4 * zz - xx - yy);
    b[3] = SH_C3_ZZZ * d.z * (2 * zz - 3 * xx - 3 * yy);
    b[4] = -SH_C3_XZZ * d.x * (4 * zz - xx - yy);
    b[5] = SH_C3_XXZ * d.z * (xx - yy);
    b[6] = -SH_C3_XXX * d.x * (xx - 3 * yy);
}

// d/d(direction) of sum_m basis_m g_m for each band, where g_m = dL/dcolour . coefficient m.
vec3 sh_gradient_1(float g[3]) { return SH_C1 * vec3(-g[2], -g[0], g[1]); }

vec3 sh_gradient_2(vec3 d, float g[5]) {
    float x = d.x, y = d.y, z = d.z;
    return SH_C2_XY * g[0] * vec3(y, x, 0) + -SH_C2_XY * g[1] * vec3(0, z, y) + SH_C2_ZZ * g[2] * vec3(-2 * x, -2 * y, 4 * z)
         + -SH_C2_XY * g[3] * vec3(z, 0, x) + SH_C2_XX * g[4] * vec3(2 * x, -2 * y, 0);
}

vec3 sh_gradient_3(vec3 d, float g[7]) {
    float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
    return -SH_C3_XXX * g[0] * vec3(6 * x * y, 3 * (xx - yy), 0)
         + SH_C3_XYZ * g[1] * vec3(y * z, x * z, x * y)
         + -SH_C3_XZZ * g[2] * vec3(-2 * x * y, 4 * zz - xx - 3 * yy, 8 * y * z)
         + SH_C3_ZZZ * g[3] * vec3(-6 * x * z, -6 * y * z, 6 * zz - 3 * (xx + yy))
         + -SH_C3_XZZ * g[4] * vec3(4 * zz - 3 * xx - yy, -2 * x * y, 8 * x * z)
         + SH_C3_XXZ * g[5] * vec3(2 * x * z, -2 * y * z, xx - yy)
         + -SH_C3_XXX * g[6] * vec3(3 * (xx - yy), -6 * x * y, 0);
}
