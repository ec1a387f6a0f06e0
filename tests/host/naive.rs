//! Float32 errors of formulas as usually written, beside ours: the figures of docs/numerics.md. `cargo test --test host
//! naive -- --nocapture` prints them; each test checks the magnitude of both.

use crate::support::seed;
use qirf_vk::random::uniform;

fn stream(kind: u64) -> impl FnMut(f64, f64) -> f64 {
    let (seed, mut at) = (seed(), 0);
    move |low, high| {
        at += 1;
        low + (high - low) * uniform(&[seed, kind, at])
    }
}

/// Median and largest error.
fn figures(mut errors: Vec<f64>) -> (f64, f64) {
    for e in &mut errors {
        *e = if e.is_nan() { f64::INFINITY } else { *e };
    }
    errors.sort_by(f64::total_cmp);
    (errors[errors.len() / 2], errors[errors.len() - 1])
}

/// Two rows of a projection, in pixels: a needle `length` long and about a pixel wide, in the image plane at any angle.
fn needle(draw: &mut impl FnMut(f64, f64) -> f64, length: f64) -> [[f32; 3]; 2] {
    let angle = draw(0.2, 1.3);
    let mut wide = || draw(-0.5, 0.5) as f32;
    [[(length * angle.cos()) as f32, wide(), wide()], [(length * angle.sin()) as f32, wide(), wide()]]
}

fn dot<T: Copy + std::ops::Mul<Output = T> + std::ops::Add<Output = T>>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross<T: Copy + std::ops::Mul<Output = T> + std::ops::Sub<Output = T>>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn wide(rows: [[f32; 3]; 2]) -> [[f64; 3]; 2] {
    rows.map(|row| row.map(f64::from))
}

/// Determinant of the image covariance: as xx yy - xy^2, and from the rows' cross product.
#[test]
fn naive_determinant() {
    let mut draw = stream(1);
    for length in [10.0, 100.0, 1000.0, 10_000.0] {
        let (mut naive, mut ours) = (Vec::new(), Vec::new());
        for _ in 0..2000 {
            let rows = needle(&mut draw, length);
            let [t0, t1] = rows;
            let (a, b, c) = (dot(t0, t0) + 0.3, dot(t0, t1), dot(t1, t1) + 0.3);
            let n = cross(t0, t1);
            let det = dot(n, n) + 0.3 * (dot(t0, t0) + dot(t1, t1)) + 0.09;
            let [d0, d1] = wide(rows);
            let m = cross(d0, d1);
            let exact = dot(m, m) + 0.3 * (dot(d0, d0) + dot(d1, d1)) + 0.09;
            naive.push((f64::from(a * c - b * b) / exact - 1.0).abs());
            ours.push((f64::from(det) / exact - 1.0).abs());
        }
        let (naive, ours) = (figures(naive), figures(ours));
        println!(
            "determinant, {length} pixels long: xx yy - xy^2 median {:.1e}, largest {:.1e}; cross product {:.1e}, {:.1e}",
            naive.0, naive.1, ours.0, ours.1
        );
        assert!(ours.1 < 2e-6 && (length < 1000.0 || naive.1 > 1e-2));
    }
}

/// Half the Mahalanobis distance of a pixel near the needle: by the conic's three products, and as u u + v v.
#[test]
fn naive_power() {
    let mut draw = stream(2);
    for length in [10.0, 100.0, 1000.0, 10_000.0] {
        let (mut naive, mut ours) = (Vec::new(), Vec::new());
        for _ in 0..2000 {
            let rows = needle(&mut draw, length);
            let along = draw(-300.0, 300.0).clamp(-length, length) / length;
            let off = [draw(-1.5, 1.5), draw(-1.5, 1.5)];
            let d: [f32; 2] = std::array::from_fn(|k| (f64::from(rows[k][0]) * along + off[k]) as f32);
            // Both use the same determinant: only the distance differs.
            let [t0, t1] = rows;
            let (a, b, c) = (dot(t0, t0) + 0.3, dot(t0, t1), dot(t1, t1) + 0.3);
            let n = cross(t0, t1);
            let det = dot(n, n) + 0.3 * (dot(t0, t0) + dot(t1, t1)) + 0.09;
            let power = 0.5 * (c / det * d[0] * d[0] + a / det * d[1] * d[1]) - b / det * d[0] * d[1];
            let k = ((c / det).sqrt(), -(b / c) * (c / det).sqrt(), c.sqrt().recip());
            let (u, v) = (k.0 * d[0] + k.1 * d[1], k.2 * d[1]);
            let [d0, d1] = wide(rows);
            let m = cross(d0, d1);
            let exact_det = dot(m, m) + 0.3 * (dot(d0, d0) + dot(d1, d1)) + 0.09;
            let (x, y) = (f64::from(d[0]), f64::from(d[1]));
            let exact_c = dot(d1, d1) + 0.3;
            let t = x - dot(d0, d1) / exact_c * y;
            let exact = 0.5 * (t * t * exact_c / exact_det + y * y / exact_c);
            naive.push((f64::from(power) - exact).abs());
            ours.push((f64::from(0.5 * (u * u + v * v)) - exact).abs());
        }
        let (naive, ours) = (figures(naive), figures(ours));
        println!(
            "power, {length} pixels long: conic median {:.1e}, largest {:.1e}; completed square {:.1e}, {:.1e}",
            naive.0, naive.1, ours.0, ours.1
        );
        assert!(ours.1 < naive.1.max(1e-5));
    }
}

/// Gradient by a needle's length through dL/dcovariance, and by whitened rows.
#[test]
fn naive_backward() {
    let mut draw = stream(3);
    for length in [10.0, 100.0, 1000.0, 10_000.0, 1e6] {
        let (mut naive, mut ours) = (Vec::new(), Vec::new());
        for _ in 0..1000 {
            let rows = needle(&mut draw, length);
            let s: [f32; 3] = std::array::from_fn(|_| draw(-1.0, 1.0) as f32); // second moments of u, v
            let [t0, t1] = rows;
            let (b, c) = (dot(t0, t1), dot(t1, t1) + 0.3);
            let n = cross(t0, t1);
            let det = dot(n, n) + 0.3 * (dot(t0, t0) + dot(t1, t1)) + 0.09;
            let (kx, kz) = ((c / det).sqrt(), c.sqrt().recip());
            let ky = -(b / c) * kx;
            // G = 1/2 K^T S K, then e = 2 G T and e . T of the first axis.
            let g =
                [kx * kx * s[0], kx * (ky * s[0] + kz * s[1]), ky * ky * s[0] + 2.0 * ky * kz * s[1] + kz * kz * s[2]];
            let e = [g[0] * t0[0] + g[1] * t1[0], g[1] * t0[0] + g[2] * t1[0]];
            naive.push(f64::from(e[0] * t0[0] + e[1] * t1[0]));
            let w = [kx * (cross(t1, n)[0] + 0.3 * t0[0]) / c, kz * t1[0]];
            ours.push(f64::from((s[0] * w[0] + s[1] * w[1]) * w[0] + (s[1] * w[0] + s[2] * w[1]) * w[1]));
            let [d0, d1] = wide(rows);
            let m = cross(d0, d1);
            let (c, det) = (dot(d1, d1) + 0.3, dot(m, m) + 0.3 * (dot(d0, d0) + dot(d1, d1)) + 0.09);
            let w = [(c / det).sqrt() * (cross(d1, m)[0] + 0.3 * d0[0]) / c, d1[0] / c.sqrt()];
            let s = s.map(f64::from);
            let exact = s[0] * w[0] * w[0] + 2.0 * s[1] * w[0] * w[1] + s[2] * w[1] * w[1];
            for errors in [&mut naive, &mut ours] {
                let last = errors.last_mut().unwrap();
                *last = (*last - exact).abs();
            }
        }
        let (naive, ours) = (figures(naive), figures(ours));
        println!(
            "gradient by length, {length} pixels: dL/dcovariance median {:.1e}, largest {:.1e}; whitened {:.1e}, {:.1e}",
            naive.0, naive.1, ours.0, ours.1
        );
        assert!(ours.1 < 1e-5 && (length < 1000.0 || naive.1 > 1e-2));
    }
}

/// A quaternion's rotation by its square, and after division by its largest component.
#[test]
fn naive_quaternion() {
    for length in [1e-25_f32, 1e-20, 1e-3, 1.0, 1e19, 1e20, 1e30] {
        let q = [0.3_f32, 0.5, -0.2, 0.1].map(|v| v * length);
        let unit = |q: [f32; 4]| {
            let norm = q.iter().map(|v| v * v).sum::<f32>().sqrt();
            q.map(|v| v / norm)
        };
        let largest = q.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        let exact = {
            let q = [0.3_f64, 0.5, -0.2, 0.1];
            let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            q.map(|v| v / norm)
        };
        let error = |got: [f32; 4]| {
            let most = got.iter().zip(exact).map(|(g, e)| (f64::from(*g) - e).abs());
            most.fold(0.0, |m: f64, e| if e.is_nan() { f64::INFINITY } else { m.max(e) })
        };
        let (naive, ours) = (error(unit(q)), error(unit(q.map(|v| v / largest))));
        println!("quaternion of length {length:e}: squares first {naive:.1e}, largest first {ours:.1e}");
        // Denormals carry 1e-20 on CPUs; GPUs flush them.
        assert!(ours < 2e-7 && ((1e-22..=1e19).contains(&length) || naive > 1e-3));
    }
}

/// The share of a fixed picture that a layer of opacity alpha hides when logits are large: 1 - sigmoid(x) for the
/// gradient.
#[test]
fn naive_sigmoid_slope() {
    for logit in [0.0_f32, 5.0, 10.0, 15.0, 17.0, 20.0, 40.0] {
        let opacity = 1.0 / (1.0 + (-logit).exp());
        let (naive, ours) = (1.0 - opacity, 1.0 / (1.0 + logit.exp()));
        let exact = 1.0 / (1.0 + f64::from(logit).exp());
        let relative = |v: f32| (f64::from(v) / exact - 1.0).abs();
        println!("1 - sigmoid({logit}): as a difference {:.1e}, directly {:.1e}", relative(naive), relative(ours));
        assert!(relative(ours) < 1e-6 && (logit < 17.0 || relative(naive) > 0.1));
    }
}

/// Adam's second moment tends to the gradient's square: beyond 1e18 (our limit) it would overflow float32 permanently.
#[test]
fn naive_second_moment() {
    for gradient in [1e-24_f32, 1e-15, 1.0, 1e18, 1e20] {
        let mut second = 0.0_f32;
        for _ in 0..20_000 {
            second = 0.999 * second + 0.001 * gradient * gradient;
        }
        println!("gradient {gradient:e}: second moment {second:e}, its root {:e}", second.sqrt());
        assert_eq!(second.is_finite(), gradient <= 1e18);
    }
}

/// Transmittance behind a layer: by dividing by 1 - alpha (back to front), and by the running product.
#[test]
fn naive_transmittance() {
    let mut draw = stream(4);
    let (mut naive, mut ours) = (Vec::new(), Vec::new());
    for _ in 0..500 {
        let alphas: Vec<f32> = (0..400).map(|_| draw(0.004, 0.05) as f32).collect();
        let mut products = vec![1.0_f32];
        let mut exact = vec![1.0_f64];
        for a in &alphas {
            let t = products[products.len() - 1];
            products.push(t - t * a);
            exact.push(exact[exact.len() - 1] * (1.0 - f64::from(*a)));
        }
        // As in an engine that stores only the last transmittance, as accumulated opacity: 1 - (1 - T).
        let mut back = 1.0 - (1.0 - products[alphas.len()]);
        for k in (0..alphas.len()).rev() {
            back /= 1.0 - alphas[k];
            naive.push((f64::from(back) / exact[k] - 1.0).abs());
            ours.push((f64::from(products[k]) / exact[k] - 1.0).abs());
        }
    }
    let (naive, ours) = (figures(naive), figures(ours));
    println!(
        "transmittance of 400 layers: backwards from alpha median {:.1e}, largest {:.1e}; forwards {:.1e}, {:.1e}",
        naive.0, naive.1, ours.0, ours.1
    );
    assert!(ours.1 < 1e-4 && naive.1 > ours.1);
}

/// Equal layers: the error of the sum of weights and transmittance, which should be 1, and dL/dalpha of layers before
/// black by three recurrences.
#[test]
fn naive_layers_alike() {
    for (alpha, layers) in
        [(0.25_f32, 10), (0.25, 28), (0.05, 180), (0.018, 500), (0.0067, 100), (0.0067, 1370), (0.0045, 2040)]
    {
        let a = f64::from(alpha);
        let left = (1.0 - a).powi(layers);
        // The picture and the remaining transmittance, by T (1 - alpha) and by T - T alpha.
        let forward = |next: fn(f32, f32) -> f32| {
            let (mut t, mut sum) = (1.0_f32, 0.0_f32);
            for _ in 0..layers {
                sum += t * alpha;
                t = next(t, alpha);
            }
            (t, sum)
        };
        let product: fn(f32, f32) -> f32 = |t, alpha| t * (1.0 - alpha);
        let difference: fn(f32, f32) -> f32 = |t, alpha| t - t * alpha;
        // White layers: T - behind / (1 - alpha), with behind = the picture minus the layers before.
        let back = |next: fn(f32, f32) -> f32| {
            let (_, mut behind) = forward(next);
            let (mut t, mut worst) = (1.0_f32, 0.0_f64);
            for _ in 0..layers {
                behind -= t * alpha;
                let slope = t - behind / (1.0 - alpha);
                worst = worst.max((f64::from(slope) - left / (1.0 - a)).abs());
                t = next(t, alpha);
            }
            worst
        };
        // From the last layer: the colour's difference to the next one's, plus (1 - alpha) times the next one's
        // difference to the colour behind it.
        let (mut t, _) = forward(difference);
        let (mut off, mut colour, mut worst) = (0.0_f32, 0.0_f32, 0.0_f64);
        for _ in 0..layers {
            off += 1.0 - colour;
            colour = 1.0;
            t /= 1.0 - alpha;
            worst = worst.max((f64::from(t * off) - left / (1.0 - a)).abs());
            off *= 1.0 - alpha;
        }
        let kept = |(t, sum): (f32, f32)| (f64::from(t) + f64::from(sum) - 1.0).abs();
        println!(
            "{layers} layers of {alpha}: sum of weights off by {:.1e} with T (1 - alpha), {:.1e} with T - T alpha; \
             dL/dalpha {:.1e}, off by {:.1e} and {:.1e}; from the back {worst:.1e}",
            kept(forward(product)),
            kept(forward(difference)),
            left / (1.0 - a),
            back(product),
            back(difference)
        );
        assert!(kept(forward(difference)) < 2e-6 && back(difference) < 4e-6);
    }
}
