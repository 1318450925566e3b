//! Samples of lines along which surfaces cross.
//!
//! On the film the one surface is seen on one side of a line, and the other one on the other side, as at a crease. From later
//! vertices, either surface is followed and hides the other one. With the normals `a` and `b`, `n` across line and view
//! towards where the second one is seen, and `n = s a + t b`, the line moves by `s a . v_a + t b . v_b` along `n`, which is
//! by `t b . (v_b - v_a)` more than the first material and by `s a . (v_a - v_b)` more than the second one. So
//!
//! `dI = sum over lines of the integral of f |cos| (L_a t b + L_b s a) . (v_b - v_a) / distance dl`:
//!
//! nothing but how fast one surface goes through the other. Both are as far away, so that the vertex may move as it
//! likes.

use ad_core::{Float, Vec3};

use super::candidates::{CANDIDATES, Candidates};
use super::form::{Contribution, Form, Mover, Term};
use super::{BEFORE, Boundary, IN_PLANE, MODE, SAME_DEPTH, wide};
use crate::bsdf::{Bsdf, Shading};
use crate::camera::CameraSample;
use crate::edges::crossing::{LineSide, Meeting, Sheet};
use crate::edges::{EdgePoint, Eye, Inside, Seeker};
use crate::estimator::Strategy;
use crate::integrator::path::Walk;
use crate::integrator::record::Place;
use crate::math::{NOWHERE, Ray, RayAdjoint, Rgb, Segment};
use crate::params::Theta;
use crate::sampler::{Purpose, Sampler};
use crate::scene::Intersection;
use crate::shape::SurfaceInteraction;

impl<P: Float> Boundary<'_, P> {
    /// The point of a line on a surface, and one beside it, with the primitive that they are on.
    fn sheet(&self, sheet: &Sheet) -> (u32, [SurfaceInteraction<P>; 2]) {
        let scene = self.context.scene;
        let at = |inside: &Inside| {
            let (prim, at) = self.surfaces.inside::<P>(sheet.shape, inside);
            (prim, scene.point_at(&Theta::still(), prim, at))
        };
        let (prim, on) = at(&sheet.on);
        (prim, [on, at(&sheet.inside).1])
    }

    /// The ray to a point beside a line, and that point; `None` if something hides it from there.
    fn towards(
        &self,
        from: Ray<P>,
        sheet: &Sheet,
        hidden: bool,
    ) -> Option<(Ray<P>, Intersection<P>)> {
        let scene = self.context.scene;
        let (prim, [_, beside]) = self.sheet(sheet);
        let way = beside.p - from.o;
        let distance = way.length();
        let ray = Ray {
            d: way * distance.recip(),
            ..from
        };
        let to = scene.exit(prim).surface;
        // A curved surface may hide itself by rounding.
        let part = if to == NOWHERE { SAME_DEPTH } else { BEFORE };
        let segment = Segment {
            ray,
            length: distance * P::of(part),
            to,
        };
        if scene.out_of_sight(&segment, hidden) {
            return None;
        }
        let si = SurfaceInteraction {
            t: distance,
            ..beside
        };
        let shape = sheet.shape;
        Some((ray, Intersection { shape, prim, si }))
    }

    /// The term of a surface at a line, along a vector.
    fn of_sheet(&self, sheet: &Sheet, along: Vec3<f64>) -> Option<Term<P>> {
        let (prim, [on, _]) = self.sheet(sheet);
        self.material(prim, sheet.shape, || on, along)
    }

    /// What a point of a line on the film brings: both surfaces, one on each side.
    pub(super) fn crossing_on_film<S: Strategy, X: Sampler>(
        &self,
        (at, eye, point, parts): (CameraSample<P>, &Eye, &EdgePoint, [LineSide; 2]),
        count: u64,
        sampler: X,
    ) -> Option<Contribution<P>> {
        let Meeting { normal, sheets } = self.surfaces.meeting(point, parts)?;
        let hidden = self.context.settings.hides(1);
        let from = |sheet: &Sheet| {
            let origin = eye.origin(sheet.inside.p()).map(P::of);
            Ray::new(origin, point.direction.map(P::of).normalize())
        };
        let [a, b] = &sheets;
        let [near, far] = [
            self.towards(from(a), a, hidden)?,
            self.towards(from(b), b, hidden)?,
        ]
        .map(|(ray, hit)| self.radiance::<S, X>(ray, Some(hit), 1, sampler));
        let jump = near - far;
        if jump.is_black() {
            return None;
        }
        let value = jump.scale(P::of(point.weight / count as f64));
        let per = point.distance.recip();
        let shares = sheets
            .iter()
            .map(|sheet| self.of_sheet(sheet, sheet.share * per));
        let mut form: Form<P> = shares.flatten().collect();
        if self.moving.camera {
            form.push(Term {
                mover: Mover::Camera(at),
                along: RayAdjoint {
                    o: (normal * -per).map(P::of),
                    d: (-normal).map(P::of),
                },
            });
        }
        Some(Contribution { value, form })
    }

    /// Whether the vertex number `depth` of a path looks for lines: its light may come from there, and that the surfaces
    /// move is seen.
    pub(super) fn crossings_at(&self, depth: u32) -> bool {
        let [any, lamps] = self.crossed;
        let most = self.context.settings.max_depth;
        depth < most && if depth + 1 < most { any } else { lamps }
    }

    /// A line seen from the vertex number `depth` of a path, and one of the surfaces that cross there.
    pub(super) fn crossing_at_vertex<S: Strategy, X: Sampler>(
        &self,
        beta: Rgb<P>,
        here: &Place<P>,
        depth: u32,
        mut sampler: X,
    ) -> Option<Contribution<P>> {
        let scene = self.context.scene;
        if scene.shape_info(here.shape).delta || beta.is_black() {
            return None;
        }
        let Place { si, wo, .. } = here;
        let sign = if wo.z >= P::zero() { 1.0 } else { -1.0 };
        let normal = wide(si.n_geo) * sign;
        let lamps_only = depth + 1 >= self.context.settings.max_depth;
        let interest =
            |shapes: std::ops::Range<u32>| if self.moving.any(shapes) { 1.0 } else { 0.0 };
        let seeker = Seeker {
            eye: Eye::point(wide(si.p)),
            normal,
            lamps: None,
            lamps_only,
            interest: &interest,
        };
        let material = scene.material(here.shape);
        let shading = Shading::new(*self.context.theta, si.uv);

        // ---- One of a few candidates ----
        sampler.seek(Purpose::Crossings(CANDIDATES).at(depth));
        let draws: [[f64; 2]; CANDIDATES as usize] = std::array::from_fn(|_| sampler.next_2d());
        let mut candidates = Candidates::new(sampler.next_1d());
        let which: f64 = sampler.next_1d();
        for u in draws {
            let Some((point, parts)) = self.crossings.draw(&seeker, u) else {
                continue;
            };
            let lit = |part: &LineSide| !lamps_only || scene.is_lamp(part.shape);
            if !parts.iter().any(lit) {
                continue;
            }
            let Some(meeting) = self.surfaces.meeting(&point, parts) else {
                continue;
            };
            // Lines on its own face are its horizon.
            if meeting.normal.dot(normal).abs() > IN_PLANE {
                continue;
            }
            let wi = si.frame.to_local(point.direction.map(P::of).normalize());
            let f = material.eval(&shading, *wo, wi, MODE);
            let shares = meeting.sheets.iter().map(|sheet| sheet.share.length());
            let target = f.max_component().to_f64() * shares.sum::<f64>() / point.distance;
            candidates.add((point, meeting, f), target, point.weight);
        }
        let ((point, Meeting { sheets, .. }, f), weight) = candidates.kept()?;

        // ---- One of the two, which the other one hides or shows ----
        let speeds = [0, 1].map(|k: usize| {
            let lit = !lamps_only || scene.is_lamp(sheets[k].shape);
            if lit {
                sheets[1 - k].share.length()
            } else {
                0.0
            }
        });
        let both = speeds[0] + speeds[1];
        let k = usize::from(which * both >= speeds[0]);
        let p = speeds[k] / both;
        if p.is_nan() || p <= 0.0 {
            return None;
        }
        let hidden = self.context.settings.hides(depth + 1);
        let direction = point.direction.map(P::of).normalize();
        let from = si.spawn_ray(direction, scene.exit(here.prim));
        let (ray, hit) = self.towards(from, &sheets[k], hidden)?;
        let light = Walk::<P, S::Still, X>::behind(ray, sampler, depth + 1, true)
            .finish_at(&self.context, Some(hit));
        if light.is_black() {
            return None;
        }
        let along = sheets[1 - k].share * point.distance.recip();
        let form = [
            self.of_sheet(&sheets[1], along),
            self.of_sheet(&sheets[0], -along),
        ];
        let form: Form<P> = form.into_iter().flatten().collect();
        let value = (beta * f * light).scale(P::of(weight / p));
        (!form.is_empty()).then_some(Contribution { value, form })
    }
}
