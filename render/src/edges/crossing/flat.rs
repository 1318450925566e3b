//! Flat surfaces: polygons and ovals, and what planes cut out of them.

use ad_core::Vec3;
use smallvec::SmallVec;

/// The least sine of the angle at which surfaces cross.
pub(super) const LEAST_SINE: f64 = 1e-3;

/// A flat surface.
pub(super) struct Flat {
    pub kind: FlatKind,
    pub normal: Vec3<f64>,
}

pub(super) enum FlatKind {
    /// Corners in order.
    Polygon(SmallVec<[Vec3<f64>; 4]>),
    /// Centre and half axes.
    Oval([Vec3<f64>; 3]),
}

/// What a plane cuts out of a flat surface.
pub(super) struct Chord {
    pub end_points: [Vec3<f64>; 2],
    /// Whether anything of the surface is below the plane, and above.
    pub sides: [bool; 2],
}

impl Flat {
    pub fn point(&self) -> Vec3<f64> {
        match &self.kind {
            FlatKind::Polygon(corners) => corners[0],
            FlatKind::Oval([centre, ..]) => *centre,
        }
    }

    /// A point of it that is not on its border.
    pub fn middle(&self) -> Vec3<f64> {
        match &self.kind {
            FlatKind::Polygon(corners) => {
                let sum = corners.iter().fold(Vec3::zero(), |sum, &p| sum + p);
                sum * (corners.len() as f64).recip()
            }
            FlatKind::Oval([centre, ..]) => *centre,
        }
    }

    fn height(&self, p: Vec3<f64>, near: f64) -> f64 {
        let h = self.normal.dot(p - self.point());
        if h.abs() <= near { 0.0 } else { h }
    }

    /// What the plane of another one cuts out of this one.
    pub fn chord(&self, plane: &Self, near: f64) -> Option<Chord> {
        match &self.kind {
            FlatKind::Polygon(corners) => {
                let n = corners.len();
                let heights: SmallVec<[f64; 4]> =
                    corners.iter().map(|&p| plane.height(p, near)).collect();
                let sides = [
                    heights.iter().any(|h| *h < 0.0),
                    heights.iter().any(|h| *h > 0.0),
                ];
                let mut end_points = SmallVec::<[Vec3<f64>; 4]>::new();
                for k in 0..n {
                    let (i, j) = (k, (k + 1) % n);
                    let (x, y) = (heights[i], heights[j]);
                    if x == 0.0 {
                        end_points.push(corners[i]);
                    } else if (x < 0.0 && y > 0.0) || (x > 0.0 && y < 0.0) {
                        end_points.push(corners[i] + (corners[j] - corners[i]) * (x / (x - y)));
                    }
                }
                let [a, b] = end_points[..] else {
                    return None;
                };
                (sides[0] || sides[1]).then_some(Chord {
                    end_points: [a, b],
                    sides,
                })
            }
            FlatKind::Oval([centre, e1, e2]) => {
                // In its own coordinates it is the unit disk.
                let h = plane.normal.dot(*centre - plane.point());
                let slopes = [*e1, *e2].map(|e| plane.normal.dot(e));
                let steep = slopes[0].hypot(slopes[1]);
                if h.abs() >= steep - near {
                    return None;
                }
                let foot = slopes.map(|g| -h * g / (steep * steep));
                let half = (1.0 - (h / steep).powi(2)).sqrt() / steep;
                let at = |side: f64| {
                    let x = foot[0] - side * half * slopes[1];
                    let y = foot[1] + side * half * slopes[0];
                    *centre + *e1 * x + *e2 * y
                };
                Some(Chord {
                    end_points: [at(-1.0), at(1.0)],
                    sides: [true; 2],
                })
            }
        }
    }

    /// Conditions `a + b cos + c sin >= 0` for an ellipse in its plane, by its centre and half axes, to be between its
    /// corners.
    pub fn conditions(&self, origin: Vec3<f64>, axes: [Vec3<f64>; 2]) -> SmallVec<[[f64; 3]; 6]> {
        let FlatKind::Polygon(corners) = &self.kind else {
            return SmallVec::new();
        };
        let n = corners.len();
        let side = |k: usize| {
            let inwards = self.normal.cross(corners[(k + 1) % n] - corners[k]);
            let [e1, e2] = axes.map(|e| inwards.dot(e));
            [inwards.dot(origin - corners[k]), e1, e2]
        };
        (0..n).map(side).collect()
    }

    /// Whether a point of its plane is on it.
    pub fn holds(&self, p: Vec3<f64>) -> bool {
        match &self.kind {
            FlatKind::Polygon(corners) => (0..corners.len()).all(|k| {
                let along = corners[(k + 1) % corners.len()] - corners[k];
                self.normal.cross(along).dot(p - corners[k]) >= 0.0
            }),
            FlatKind::Oval([centre, e1, e2]) => {
                let (p, n) = (p - *centre, e1.cross(*e2));
                let x = p.cross(*e2).dot(n);
                let y = e1.cross(p).dot(n);
                x.hypot(y) <= n.length_squared()
            }
        }
    }

    /// The part of a segment in its plane that is on it.
    pub fn clipped(&self, start: Vec3<f64>, along: Vec3<f64>) -> Option<[Vec3<f64>; 2]> {
        // As what a plane through the segment cuts out.
        let across = Self {
            kind: FlatKind::Oval([start, along, self.normal]),
            normal: along.cross(self.normal).normalize(),
        };
        let chord = self.chord(&across, 0.0)?;
        let at = |p: Vec3<f64>| along.dot(p - start) / along.length_squared();
        let [a, b] = chord.end_points.map(at);
        let (from, to) = (a.min(b).max(0.0), a.max(b).min(1.0));
        (from < to).then(|| [start + along * from, along * (to - from)])
    }
}
