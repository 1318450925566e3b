//! The same functions in the peers' scalars: `num-dual` (vector duals) and `reverse` (heap tape).

use num_dual::{DualNum, DualSVec32};
use reverse::{Gradient, Tape, Var};

/// GGX in `num-dual`; formulas as in [`kernels`](crate::kernels).
fn ggx_dual<D: DualNum<Primitive = f32> + Copy>([a, f0, ix, iy, iz, ox, oy, oz]: [D; 8]) -> D {
    let (hx, hy, hz) = (ix + ox, iy + oy, iz + oz);
    let inv_len = (hx * hx + hy * hy + hz * hz).sqrt().recip();
    let (hx, hy, hz) = (hx * inv_len, hy * inv_len, hz * inv_len);
    let m = -(ix * hx + iy * hy + iz * hz) + 1.0;
    let m2 = m * m;
    let f = f0 + (-f0 + 1.0) * (m2 * m2 * m);
    let inv = a.recip();
    let (sx, sy) = (hx * inv, hy * inv);
    let q = inv / (sx * sx + sy * sy + hz * hz);
    let l = |x: D, y: D, z: D| (z + (z * z + a * a * (x * x + y * y)).sqrt()).recip();
    q * q * std::f32::consts::FRAC_1_PI * f * l(ix, iy, iz) * l(ox, oy, oz) * iz
}

/// Value and the eight derivatives by vector duals.
pub fn ggx_num_dual(x: &[f32; 8]) -> (f32, [f32; 8]) {
    let y = ggx_dual(std::array::from_fn(|i| {
        DualSVec32::<8>::from_re(x[i]).derivative(i)
    }));
    let eps = y.eps.0.unwrap_or_default();
    (y.re, std::array::from_fn(|i| eps[i]))
}

/// Value and the eight derivatives on a tape, in f64 (the only precision of `reverse`).
pub fn ggx_tape(tape: &Tape, x: &[f32; 8]) -> (f32, [f32; 8]) {
    tape.clear();
    let v: [Var; 8] = std::array::from_fn(|i| tape.add_var(f64::from(x[i])));
    let [a, f0, ix, iy, iz, ox, oy, oz] = v;
    let (hx, hy, hz) = (ix + ox, iy + oy, iz + oz);
    let inv_len = (hx * hx + hy * hy + hz * hz).sqrt().recip();
    let (hx, hy, hz) = (hx * inv_len, hy * inv_len, hz * inv_len);
    let m = -(ix * hx + iy * hy + iz * hz) + 1.0;
    let m2 = m * m;
    let f = f0 + (-f0 + 1.0) * (m2 * m2 * m);
    let inv = a.recip();
    let (sx, sy) = (hx * inv, hy * inv);
    let q = inv / (sx * sx + sy * sy + hz * hz);
    let l = |i: usize| {
        let (x, y, z) = (v[i], v[i + 1], v[i + 2]);
        (z + (z * z + a * a * (x * x + y * y)).sqrt()).recip()
    };
    let y = q * q * std::f64::consts::FRAC_1_PI * f * l(2) * l(5) * iz;
    let g = y.grad();
    (y.val() as f32, std::array::from_fn(|i| g.wrt(&v[i]) as f32))
}

/// State and nine derivatives of the chain by vector duals carried through all steps.
pub fn chain_num_dual(p: &[f32; 8], x0: f32, steps: usize) -> [f32; 9] {
    let p: [DualSVec32<9>; 8] = std::array::from_fn(|i| DualSVec32::from_re(p[i]).derivative(i));
    let mut x = DualSVec32::<9>::from_re(x0).derivative(8);
    for k in 0..steps {
        x += (p[k % 8] - x * x * x) * (x + 1.0) * 0.05;
    }
    let eps = x.eps.0.unwrap_or_default();
    std::array::from_fn(|i| eps[i])
}

/// The nine derivatives of the chain on a tape.
pub fn chain_tape(tape: &Tape, p: &[f32; 8], x0: f32, steps: usize) -> [f32; 9] {
    tape.clear();
    let p: [Var; 8] = std::array::from_fn(|i| tape.add_var(f64::from(p[i])));
    let first = tape.add_var(f64::from(x0));
    let mut x = first;
    for k in 0..steps {
        x = x + (p[k % 8] - x * x * x) * (x + 1.0) * 0.05;
    }
    let g = x.grad();
    std::array::from_fn(|i| g.wrt(if i < 8 { &p[i] } else { &first }) as f32)
}
