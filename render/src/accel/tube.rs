//! Tubes around curves: spans of cubic B-splines whose circular cross section varies along them, and cones with a ball at
//! either end.
//!
//! Only the outside is met, as in Mitsuba 3: a ray that starts within passes. That leaves one kind of root to be found,
//! where the distance to the curve less the radius falls to zero along the ray. Along a straight piece whose radius is
//! linear it is that of a quadratic; along others the quadratic of the piece at hand is solved again and again, which is
//! Newton's method but for the square root. Steps are counted, so that it ends for any numbers. Where a ray is nearly
//! parallel to a piece that bends, so that it may enter it twice, the piece is halved.
//!
//! All in f64: the quadratics cancel as those of balls do.

use ad_core::{Real, Vec3};
use smallvec::SmallVec;

use super::MIN_THICKNESS;

/// Most steps towards a root.
const STEPS: usize = 16;

/// A step of less than this part of the size of a piece is the last one: the next would be as small as its square.
const LAST_STEP: f64 = 1e-5;

/// Pieces overlap by this part of their length, so that rounding opens no gap between them.
const OVERLAP: f64 = 1e-6;

/// A piece that leaves its chord, and whose radius is not linear, by less than this part of the radius counts as
/// straight: what enters it twice only touches it.
const STRAIGHT: f64 = 0.02;

/// A span is halved so often, at most.
const MOST_HALVINGS: i32 = 7;

/// Where a ray enters: the distance twice, and surface coordinates; NaN if it does not.
pub(super) type Entry = [f64; 4];

/// Nowhere.
const NONE: Entry = [f64::NAN; 4];

/// A span of a uniform cubic B-spline, in powers of its parameter, which runs from zero to one: the point, and the radius
/// of the cross section.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cubic<R> {
    p: [Vec3<R>; 4],
    r: [R; 4],
}

/// A point on the middle of a tube, and its derivatives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Along<R> {
    /// The point.
    pub c: Vec3<R>,
    /// First derivative.
    pub c1: Vec3<R>,
    /// Second derivative.
    pub c2: Vec3<R>,
    /// Radius.
    pub r: R,
    /// Its derivative.
    pub r1: R,
}

impl<R: Real> Cubic<R> {
    /// From four control points, each with a radius.
    pub fn new(points: &[[f32; 4]; 4]) -> Self {
        let at = |k: usize| points.map(|q| R::lift(<R::Primal as Real>::of(f64::from(q[k]))));
        let powers = |[a, b, c, d]: [R; 4]| {
            let sixth = R::c(1.0 / 6.0);
            [
                (a + c) * sixth + b * R::c(2.0 / 3.0),
                (c - a) * R::c(0.5),
                (a - b + (c - b)) * R::c(0.5),
                (d - a) * sixth + (b - c) * R::c(0.5),
            ]
        };
        let [x, y, z, r] = [0, 1, 2, 3].map(|k: usize| powers(at(k)));
        Self {
            p: [0, 1, 2, 3].map(|k: usize| Vec3::new(x[k], y[k], z[k])),
            r,
        }
    }

    #[inline(always)]
    pub fn at(&self, u: R) -> Along<R> {
        let [p0, p1, p2, p3] = self.p;
        let [r0, r1, r2, r3] = self.r;
        let (two, three, six) = (R::c(2.0), R::c(3.0), R::c(6.0));
        Along {
            c: p0 + (p1 + (p2 + p3 * u) * u) * u,
            c1: p1 + (p2 * two + p3 * (u * three)) * u,
            c2: p2 * two + p3 * (u * six),
            r: r0 + (r1 + (r2 + r3 * u) * u) * u,
            r1: r1 + (r2 * two + r3 * (u * three)) * u,
        }
    }
}

/// The control points of Bezier of a part of a span: it lies in their hull.
struct Hull {
    p: [Vec3<f64>; 4],
    /// Radii there.
    r: [f64; 4],
}

impl Cubic<f64> {
    fn hull(&self, [low, high]: [f64; 2]) -> Hull {
        let (a, b) = (self.at(low), self.at(high));
        let third = (high - low) / 3.0;
        Hull {
            p: [a.c, a.c + a.c1 * third, b.c - b.c1 * third, b.c],
            r: [a.r, a.r + a.r1 * third, b.r - b.r1 * third, b.r],
        }
    }

    /// A capsule around a part of the tube, and how the part bends: the largest angle between it and the capsule's axis,
    /// radians; zero if it hardly does, and infinite where its speed is so uneven that it does not tell.
    pub fn capsule(&self, range: [f64; 2]) -> Capsule {
        let Hull { p, r } = self.hull(range);
        let (from, to) = (p[0], p[3]);
        let axis = to - from;
        let squared = axis.length_squared();
        let beside = |q: Vec3<f64>| {
            let along = (q - from).dot(axis) / squared;
            let along = if along.is_finite() { along } else { 0.0 };
            (q - from - axis * along.clamp(0.0, 1.0)).length()
        };
        let length = squared.sqrt();
        let mut bend: f64 = 0.0;
        for leg in [p[1] - p[0], p[2] - p[1], p[3] - p[2]] {
            let size = leg.length();
            let even = size > length / 9.0 && size < length;
            let along = leg.dot(axis);
            let angle = leg.cross(axis).length().atan2(along);
            bend = bend.max(if even { angle } else { f64::INFINITY });
        }
        let off = beside(p[1]).max(beside(p[2]));
        let swells = [1, 2].map(|k| (r[k] - r[0] - (r[3] - r[0]) * (k as f64 / 3.0)).abs());
        let rough = off + swells[0].max(swells[1]);
        if bend.is_finite() && rough <= STRAIGHT * r.into_iter().fold(f64::INFINITY, f64::min) {
            bend = 0.0;
        }
        Capsule {
            from,
            to,
            radius: r.into_iter().fold(0.0, f64::max) + off,
            bend,
        }
    }
}

/// All points nearer to a segment than a radius.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Capsule {
    pub from: Vec3<f64>,
    pub to: Vec3<f64>,
    pub radius: f64,
    /// See [`Cubic::capsule`].
    pub bend: f64,
}

impl Capsule {
    /// Where the line comes nearest to the axis: its distance along the line, and the part of the axis. `None` if the
    /// line passes by.
    #[inline(always)]
    fn nearest(&self, o: Vec3<f64>, d: Vec3<f64>) -> Option<[f64; 2]> {
        let axis = self.to - self.from;
        let to = self.from - o;
        let (dd, de, ee) = (d.length_squared(), d.dot(axis), axis.length_squared());
        let (dt, et) = (d.dot(to), axis.dot(to));
        let s = (de * dt - dd * et) / (dd * ee - de * de);
        let s = if s.is_finite() {
            s.clamp(0.0, 1.0)
        } else {
            0.5
        };
        let t = (dt + s * de) / dd;
        let off = to + axis * s - d * t;
        (off.length_squared() <= self.radius * self.radius).then_some([t, s])
    }

    /// Whether a ray in this direction enters the tube within at most once: the distance from the curve has one minimum
    /// along it. Its second derivative is positive where the square of the sine between ray and curve exceeds the
    /// curvature times the distance.
    #[inline(always)]
    fn is_entered_once(&self, d: Vec3<f64>) -> bool {
        if self.bend == 0.0 {
            return true;
        }
        let axis = self.to - self.from;
        let length = axis.length();
        let sine = d.cross(axis).length() / (d.length() * length);
        let spare = sine - self.bend;
        let curvature = 2.0 * self.bend / length;
        spare > 0.0 && spare * spare > curvature * 2.0 * self.radius
    }
}

/// A part of a span of a B-spline.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    points: [[f32; 4]; 4],
    from: [f32; 3],
    to: [f32; 3],
    radius: f32,
    bend: f32,
    /// Which of how many.
    part: [u8; 2],
}

/// Rounded to single precision, and no smaller.
fn up(x: f64) -> f32 {
    let single = x as f32;
    if f64::from(single) < x {
        single.next_up()
    } else {
        single
    }
}

/// Which values of the parameter a part has.
pub(crate) fn range([k, n]: [u8; 2]) -> [f64; 2] {
    [k, k + 1].map(|k| f64::from(k) / f64::from(n))
}

fn single(v: Vec3<f64>) -> [f32; 3] {
    v.to_array().map(|x| x as f32)
}

fn double(v: [f32; 3]) -> Vec3<f64> {
    Vec3::from(v.map(f64::from))
}

/// Ends of the axis of a capsule in single precision, its radius and how the part bends.
pub(crate) fn rounded(capsule: &Capsule) -> ([[f32; 3]; 2], f32, f32) {
    let end_points = [capsule.from, capsule.to];
    let rounded = end_points.map(single);
    let moved = |k: usize| (double(rounded[k]) - end_points[k]).length();
    let radius = up(capsule.radius + moved(0).max(moved(1)));
    (rounded, radius, up(capsule.bend))
}

impl Span {
    /// `None` if it has no radius.
    pub fn new(points: [[f32; 4]; 4], part: [u8; 2]) -> Option<Self> {
        let thick = points.iter().any(|p| p[3] >= MIN_THICKNESS);
        let valid = part[0] < part[1] && points.as_flattened().iter().all(|x| x.is_finite());
        if !(thick && valid) {
            return None;
        }
        let capsule = Cubic::new(&points).capsule(range(part));
        let ([from, to], radius, bend) = rounded(&capsule);
        Some(Self {
            points,
            from,
            to,
            radius,
            bend,
            part,
        })
    }

    #[inline]
    pub fn entry(&self, o: [f64; 3], d: [f64; 3]) -> Entry {
        let (o, d) = (Vec3::from(o), Vec3::from(d));
        let capsule = Capsule {
            from: double(self.from),
            to: double(self.to),
            radius: f64::from(self.radius),
            bend: f64::from(self.bend),
        };
        match capsule.nearest(o, d) {
            Some(near) => self.within(o, d, &capsule, near),
            None => NONE,
        }
    }

    #[inline(never)]
    fn within(&self, o: Vec3<f64>, d: Vec3<f64>, capsule: &Capsule, near: [f64; 2]) -> Entry {
        let cubic = Cubic::new(&self.points);
        let whole = range(self.part);
        let width = whole[1] - whole[0];
        let finest = width * 0.5f64.powi(MOST_HALVINGS);
        let within = whole[0] - OVERLAP * width..=whole[1] + OVERLAP * width;
        let mut best = NONE;
        let mut offer = |capsule: &Capsule, range, near| {
            if let Some([t, u]) = enter(&cubic, o, d, capsule, range, near)
                && t > 0.0
                && within.contains(&u)
                && (best[0].is_nan() || t < best[0])
            {
                best = [t, t, u, 0.0];
            }
        };
        if capsule.is_entered_once(d) {
            offer(capsule, whole, near);
            return best;
        }
        let halves = |[low, high]: [f64; 2]| {
            let middle = 0.5 * (low + high);
            [[low, middle], [middle, high]]
        };
        let mut open = SmallVec::<[[f64; 2]; 16]>::from_slice(&halves(whole));
        while let Some(part) = open.pop() {
            let capsule = cubic.capsule(part);
            let Some(near) = capsule.nearest(o, d) else {
                continue;
            };
            if capsule.is_entered_once(d) || part[1] - part[0] <= finest {
                offer(&capsule, part, near);
            } else {
                open.extend(halves(part));
            }
        }
        best
    }
}

/// Where a line enters a tube: distance and parameter, which may lie beside the part that is searched. `near` is the start,
/// on the line and along the capsule.
fn enter(
    cubic: &Cubic<f64>,
    o: Vec3<f64>,
    d: Vec3<f64>,
    capsule: &Capsule,
    [low, high]: [f64; 2],
    [mut t, s]: [f64; 2],
) -> Option<[f64; 2]> {
    let width = high - low;
    let mut u = low + s * width;
    let small = LAST_STEP * capsule.radius / d.length();
    let mut missed = 0;
    for _ in 0..STEPS {
        let Along { c, c1, c2, r, r1 } = cubic.at(u);
        let w = o + d * t - c;
        let speed = c1.length_squared();
        let bent = speed - w.dot(c2);
        // Beyond the centre of curvature there is no nearest point; and a curve may stop.
        let h = bent.max(0.1 * speed).max(f64::MIN_POSITIVE);
        // To first order the nearest point goes along so, and the radius there.
        let (begin, along) = (w.dot(c1) / h, d.dot(c1) / h);
        let (w, d) = (w - c1 * begin, d - c1 * along);
        let (r, slope) = (r + r1 * begin, r1 * along);
        let a = d.length_squared() - slope * slope;
        let b = w.dot(d) - r * slope;
        let spare = b * b - a * (w.length_squared() - r * r);
        let root = spare.max(0.0).sqrt();
        // To where the line comes nearest, if it passes by.
        let step = if b < 0.0 && spare >= 0.0 {
            (w.length_squared() - r * r) / (root - b)
        } else {
            -(b + root) / a
        };
        if !step.is_finite() {
            return None;
        }
        let slide = begin + along * step;
        let next = u + slide;
        (t, u) = (t + step, next.clamp(low - width, high + width));
        if spare < 0.0 || u != next {
            missed += 1;
            if missed > 3 {
                return None;
            }
        } else if step.abs() <= small && slide.abs() <= LAST_STEP * width {
            return (bent > 0.0).then_some([t, u]);
        }
    }
    None
}

/// All points of balls along a segment whose radius is linear: a cone, and a part of the ball at either end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cone {
    p0: [f64; 3],
    /// Of unit length.
    axis: [f64; 3],
    length: f64,
    radii: [f64; 2],
}

impl Cone {
    /// `None` if both radii vanish.
    pub fn new(p0: [f32; 3], axis: [f32; 3], radii: [f32; 2]) -> Option<Self> {
        let axis = double(axis);
        let thick = radii[0].max(radii[1]) >= MIN_THICKNESS;
        (thick && radii[0].min(radii[1]) >= 0.0).then(|| Self {
            p0: p0.map(f64::from),
            axis: axis.normalize().to_array(),
            length: axis.length(),
            radii: radii.map(f64::from),
        })
    }

    /// The surface coordinate is where on the axis the ball is whose normal that of the point is.
    #[inline]
    pub fn entry(&self, o: [f64; 3], d: [f64; 3]) -> Entry {
        let (o, d) = (Vec3::from(o), Vec3::from(d));
        let (p0, axis) = (Vec3::from(self.p0), Vec3::from(self.axis));
        let [r0, r1] = self.radii;
        let dd = d.length_squared();
        let shift = (p0 - o).dot(d) / dd;
        // From the first end to the point of the line next to it.
        let q = o + d * shift - p0;
        let mut best = [f64::INFINITY, 0.0];
        let mut offer = |t: f64, v: f64| {
            if t < best[0] {
                best = [t, v];
            }
        };
        for (r, v) in [(r0, 0.0), (r1, 1.0)] {
            let to = axis * (self.length * v) - q;
            let middle = to.dot(d) / dd;
            let spare = r * r - (to - d * middle).length_squared();
            if spare >= 0.0 {
                offer(middle - (spare / dd).sqrt(), v);
            }
        }
        let sine = (r0 - r1) / self.length;
        if sine.abs() < 1.0 {
            let m = (1.0 - sine) * (1.0 + sine);
            let (y, dy) = (q.dot(axis), d.dot(axis));
            let across = q - axis * y;
            let r = r0 - sine * y;
            let a = m * dd - dy * dy;
            let b = m * across.dot(d) + sine * dy * r;
            let c = m * across.length_squared() - r * r;
            let spare = b * b - a * c;
            if spare >= 0.0 {
                let root = spare.sqrt();
                let t = if b < 0.0 {
                    c / (root - b)
                } else {
                    -(b + root) / a
                };
                let v = (y + t * dy - sine * r0) / (m * self.length);
                if (0.0..=1.0).contains(&v) {
                    offer(t, v);
                }
            }
        }
        let t = shift + best[0];
        if t > 0.0 && t < f64::INFINITY {
            [t, t, best[1], 0.0]
        } else {
            NONE
        }
    }
}
