// Real spherical harmonics as 3DGS uses them, to degree 3.
const float SH_C0 = 0.28209479177387814;
const float SH_C1 = 0.4886025119029199;
const float SH_C2[5] = float[](1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396);
const float SH_C3[7] = float[](-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154,
                               -0.4570457994644658, 1.445305721320277, -0.5900435899266435);

void sh_basis_1(vec3 d, out float b[3]) {
    b[0] = -SH_C1 * d.y;
    b[1] = SH_C1 * d.z;
    b[2] = -SH_C1 * d.x;
}

void sh_basis_2(vec3 d, out float b[5]) {
    b[0] = SH_C2[0] * d.x * d.y;
    b[1] = SH_C2[1] * d.y * d.z;
    b[2] = SH_C2[2] * (2 * d.z * d.z - d.x * d.x - d.y * d.y);
    b[3] = SH_C2[3] * d.x * d.z;
    b[4] = SH_C2[4] * (d.x * d.x - d.y * d.y);
}

void sh_basis_3(vec3 d, out float b[7]) {
    float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z;
    b[0] = SH_C3[0] * d.y * (3 * xx - yy);
    b[1] = SH_C3[1] * d.x * d.y * d.z;
    b[2] = SH_C3[2] * d.y * (4 * zz - xx - yy);
    b[3] = SH_C3[3] * d.z * (2 * zz - 3 * xx - 3 * yy);
    b[4] = SH_C3[4] * d.x * (4 * zz - xx - yy);
    b[5] = SH_C3[5] * d.z * (xx - yy);
    b[6] = SH_C3[6] * d.x * (xx - 3 * yy);
}

// Adds d/d(direction) of sum_m basis_m g_m, g being dL/dcolour . coefficient, band by band.
vec3 sh_gradient_1(float g[3]) { return SH_C1 * vec3(-g[2], -g[0], g[1]); }

vec3 sh_gradient_2(vec3 d, float g[5]) {
    float x = d.x, y = d.y, z = d.z;
    return SH_C2[0] * g[0] * vec3(y, x, 0) + SH_C2[1] * g[1] * vec3(0, z, y) + SH_C2[2] * g[2] * vec3(-2 * x, -2 * y, 4 * z)
         + SH_C2[3] * g[3] * vec3(z, 0, x) + SH_C2[4] * g[4] * vec3(2 * x, -2 * y, 0);
}

vec3 sh_gradient_3(vec3 d, float g[7]) {
    float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
    return SH_C3[0] * g[0] * vec3(6 * x * y, 3 * (xx - yy), 0)
         + SH_C3[1] * g[1] * vec3(y * z, x * z, x * y)
         + SH_C3[2] * g[2] * vec3(-2 * x * y, 4 * zz - xx - 3 * yy, 8 * y * z)
         + SH_C3[3] * g[3] * vec3(-6 * x * z, -6 * y * z, 6 * zz - 3 * (xx + yy))
         + SH_C3[4] * g[4] * vec3(4 * zz - 3 * xx - yy, -2 * x * y, 8 * x * z)
         + SH_C3[5] * g[5] * vec3(2 * x * z, -2 * y * z, xx - yy)
         + SH_C3[6] * g[6] * vec3(3 * (xx - yy), -6 * x * y, 0);
}
