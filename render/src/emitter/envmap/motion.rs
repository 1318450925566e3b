//! How a sampled direction moves with the texels, while its random numbers stay.
//!
//! A sample depends on ten numbers that are linear in the luminance: the integral over the sphere, that over
//! the bands before, the sums of two rows, how far those sums have come before the cell, and the corners
//! of the cell. The place in the cell and its density are inverted once more over duals of these. Forward
//! mode keeps the tangents of all sums ([`Shift`]), made once per pass; reverse mode adds the adjoints
//! of the sums up, and folds them into the texels once at its end ([`Envmap::fold`]). So a sample costs the
//! same whatever the size of the map.

use std::f64::consts::FRAC_1_PI;

use ad_core::{Dual, Float, Real, Vec2, Vec3};

use super::Envmap;
use super::table::{Draw, Local, UNIFORM_FRACTION, mix};
use crate::emitter::Emission;
use crate::math::{LUMINANCE, Rgb};
use crate::params::{GradSink, ParamRef, Theta};

/// How many numbers a sample depends on.
const LOCALS: usize = 10;

/// Of a map that is darker than this in all (density over luminance), derivatives by the texels would
/// not fit a single-precision number: its samples stand still.
const STEEPEST: f64 = 1e25;

/// One of the numbers that a sample depends on.
#[derive(Clone, Copy, Debug)]
enum Number {
    /// Zero.
    Nothing,
    /// An element of the sums.
    Sum(usize),
    /// The luminance of a texel.
    Texel(usize),
}

/// A sampled direction, and how it moves.
#[derive(Clone, Copy, Debug)]
pub struct MovingDraw {
    band: usize,
    cell: usize,
    at: Draw<f64>,
    numbers: [Number; LOCALS],
    /// Derivatives of the place in the cell (across, down) and of its density (4 pi times that per solid
    /// angle) by those numbers.
    slopes: [[f64; LOCALS]; 3],
}

/// A sample of an emitter that moves with its parameters.
#[derive(Clone, Copy, Debug)]
pub struct Moved<R> {
    /// Unit direction to the light, world space.
    pub d: Vec3<R>,
    /// Density per solid angle.
    pub pdf: R,
    /// The density that the current, constant texels have in that direction: what weights are made of.
    pub frozen_pdf: R,
    /// What arrives.
    pub emission: Emission<R>,
}

/// Tangents of all sums of the luminance.
#[derive(Clone, Debug)]
pub struct Shift<R> {
    sums: Vec<R>,
}

impl Envmap {
    /// The sample that [`crate::emitter::Emitter::sample`] makes of `u`, as it moves. `None` if it does not:
    /// a black map is sampled uniformly.
    ///
    /// # Derivatives
    /// First derivatives in the texels.
    pub fn moving_draw<P: Float>(&self, u: [P; 2]) -> Option<MovingDraw> {
        let table = &self.table;
        let slope = table.slope;
        if !(slope > 0.0 && slope < STEEPEST) {
            return None;
        }
        let u = [u[0].to_f64(), u[1].to_f64()];
        let (band, cell, at) = table.draw(u);
        let (rows, columns) = (table.rows(band), table.columns(cell));
        let mut numbers = [Number::Sum(table.len() - 1); LOCALS];
        let sum = |at: Option<usize>| at.map_or(Number::Nothing, Number::Sum);
        numbers[1] = sum(table.before(band));
        for (k, row) in rows.into_iter().enumerate() {
            numbers[2 + k] = Number::Sum(table.row(row));
            numbers[4 + k] = sum(table.line(row, cell));
            for (i, column) in columns.into_iter().enumerate() {
                numbers[6 + 2 * k + i] = Number::Texel(row * table.width + column);
            }
        }
        // What is made of the density changes with its own number, and with the integral that it is
        // divided by: that scales all of it but the uniform part.
        let total = (1.0 - UNIFORM_FRACTION) / slope;
        let var = |k: usize, value: f64| {
            let uniform = match numbers[k] {
                Number::Nothing => value,
                Number::Sum(i) => UNIFORM_FRACTION * table.uniform_sum(i),
                Number::Texel(_) => UNIFORM_FRACTION,
            };
            let mut x = Dual::<f64, LOCALS>::constant(value);
            x.eps[0] = (uniform - value) / total;
            if !matches!(numbers[k], Number::Nothing) {
                x.eps[k] = slope;
            }
            x
        };
        let l = table.local(band, cell);
        let [rows, lines] =
            [(2, l.rows), (4, l.lines)].map(|(k, v)| [var(k, v[0]), var(k + 1, v[1])]);
        let local = Local {
            before: var(1, l.before),
            rows,
            lines,
            corners: [0, 1].map(|k| [0, 1].map(|i| var(6 + 2 * k + i, l.corners[k][i]))),
        };
        let moving = table.draw_from(band, u, &local);
        Some(MovingDraw {
            band,
            cell,
            at,
            numbers,
            slopes: [moving.x.eps, moving.y.eps, moving.density.eps],
        })
    }

    /// The tangents of all sums when the parameters move; `None` if the texels do not.
    pub fn shift<R: Real>(&self, theta: &Theta<R>) -> Option<Shift<R>> {
        let moves = theta.moves(self.param) && self.table.slope > 0.0;
        moves.then(|| Shift {
            sums: self.table.sums_of(|i| self.tangent(theta, i)),
        })
    }

    /// The tangent of the luminance of a texel.
    fn tangent<R: Real>(&self, theta: &Theta<R>, texel: usize) -> R {
        let l = Rgb::from(theta.texel::<3>(self.param, texel)).luminance();
        l - R::lift(l.primal())
    }

    /// The sample of `draw` when the parameters move.
    pub fn moved<R: Real>(
        &self,
        draw: &MovingDraw,
        theta: &Theta<R>,
        shift: &Shift<R>,
    ) -> Moved<R> {
        let tangents = draw.numbers.map(|number| match number {
            Number::Nothing => R::zero(),
            Number::Sum(i) => shift.sums[i],
            Number::Texel(i) => self.tangent(theta, i),
        });
        let each = |value: f64, slopes: &[f64; LOCALS]| {
            let terms = tangents.iter().zip(slopes).map(|(t, s)| *t * R::c(*s));
            terms.fold(R::of(value), |sum, t| sum + t)
        };
        let [x, y, density] = &draw.slopes;
        self.placed(
            draw,
            Draw {
                x: each(draw.at.x, x),
                y: each(draw.at.y, y),
                density: each(draw.at.density, density),
            },
        )
    }

    /// The sample of `draw` as a function of its place in the cell and its density: the three tangents.
    /// [`Envmap::pull_back`] takes them to the texels.
    pub fn vary<P: Float>(&self, draw: &MovingDraw) -> Moved<Dual<P, 3>> {
        let var = |value, k| Dual::var(P::of(value), k);
        let Draw { x, y, density } = draw.at;
        let at = Draw {
            x: var(x, 0),
            y: var(y, 1),
            density: var(density, 2),
        };
        self.placed(draw, at)
    }

    fn placed<R: Real>(&self, draw: &MovingDraw, at: Draw<R>) -> Moved<R> {
        type Place = Dual<f64, 2>;
        let place = [Place::var(draw.at.x, 0), Place::var(draw.at.y, 1)];
        let edges = [self.table.edges[draw.band], self.table.edges[draw.band + 1]];
        let (d, [u, v]) = self.towards(draw.cell as f64, edges, place);
        let rows = self.table.corners(draw.band, draw.cell);
        let side = |i: usize| mix(rows.map(|row| Place::constant(row[i])), place[1]);
        let frozen = mix([side(0), side(1)], place[0]);

        let [x, y] = [at.x, at.y].map(|x| x - R::lift(x.primal()));
        let chain =
            |value: R::Primal, f: Place| R::lift(value) + x * R::c(f.eps[0]) + y * R::c(f.eps[1]);
        let of = |f: Place| chain(R::Primal::of(f.re), f);
        let unit: Vec3<R::Primal> = d.map(|x| R::Primal::of(x.re)).normalize();
        let per_angle = R::c(0.25 * FRAC_1_PI);
        Moved {
            d: Vec3::new(chain(unit.x, d.x), chain(unit.y, d.y), chain(unit.z, d.z)),
            pdf: at.density * per_angle,
            frozen_pdf: of(frozen) * per_angle,
            emission: Emission {
                uv: Vec2::new(of(u), of(v)),
                falloff: R::one(),
            },
        }
    }

    /// Takes the adjoints of the three numbers of [`Envmap::vary`] to the texels, and those of the sums
    /// to `sum`.
    pub fn pull_back<P: Float, G: GradSink<P>>(
        &self,
        draw: &MovingDraw,
        d: [P; 3],
        grad: &mut G,
        mut sum: impl FnMut(&mut G, usize, f64),
    ) {
        for (k, number) in draw.numbers.into_iter().enumerate() {
            let terms = draw.slopes.iter().zip(d).map(|(s, d)| s[k] * d.to_f64());
            let adjoint: f64 = terms.sum();
            match number {
                Number::Nothing => {}
                Number::Sum(i) => sum(grad, i, adjoint),
                Number::Texel(i) => {
                    for (c, w) in LUMINANCE.into_iter().enumerate() {
                        grad.add(self.param, 3 * i + c, P::of(adjoint * w));
                    }
                }
            }
        }
    }

    /// The range of its texels.
    pub fn texels(&self) -> ParamRef {
        self.param
    }

    /// Number of sums.
    pub fn sums(&self) -> usize {
        self.table.len()
    }

    /// Adds to `texels`, `[height][width][3]`, the adjoint that those of all sums come to.
    pub fn fold(&self, sums: &[f64], texels: &mut [f64]) {
        let luminance = self.table.fold(sums);
        for (texel, d) in texels.chunks_exact_mut(3).zip(luminance) {
            for (t, w) in texel.iter_mut().zip(LUMINANCE) {
                *t += d * w;
            }
        }
    }
}
