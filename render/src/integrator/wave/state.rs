//! What a wave of paths knows at a time: of the paths, where they are, of sampled lights and of scattered directions.

use ad_core::{Float, Vec2, Vec3};

use super::kinds::seen_from;
use super::lanes::{Field, Lane, Lanes, lanes};
use crate::emitter::{Emission, EmitterSample};
use crate::integrator::vertex::interest::PathInterest;
use crate::manifold::Run;
use crate::math::{Frame, NOWHERE};
use crate::shape::{Exit, SurfaceInteraction};

lanes! {
    /// What paths take along. The names are those of [`super::super::path::Walk`].
    Paths {
        /// Number within the wave, in the order of their start.
        id: Lane<u32>,
        /// Place among the vertices before.
        slot: Lane<u32>,
        /// Of their random numbers, see [`crate::sampler::Stream`].
        key: Lane<u64>,
        /// Likewise.
        index: Lane<u32>,
        /// Origin of the next edge.
        o: Lanes<P>,
        /// Its direction.
        d: Lanes<P>,
        /// The surface that it leaves.
        surface: Lane<u32>,
        /// Throughput.
        beta: Lanes<P>,
        /// Radiance so far.
        l: Lanes<P>,
        /// The vertex before.
        from: Lanes<P>,
        /// Relative index along the path.
        eta: Lane<P>,
        /// What roulette goes by.
        roulette_weight: Lane<P>,
        /// Density of the last direction; zero if it was a delta.
        pdf: Lane<P>,
        /// Whether a vertex so far is one that the log differentiates.
        active: Lane<u32>,
        /// Whether others find caustics on the first vertex, in the lowest bit; [`BENT`], which is kept where emitters are hidden.
        caustics_excluded: Lane<u32>,
        /// Whether light on this edge would be one, in the lowest bit; above it, where the path is on a specular chain.
        caustic: Lane<u32>,
    }
}

lanes! {
    /// Where paths are.
    Vertices {
        /// Whether they are anywhere.
        there: Lane<u32>,
        /// Index of the material.
        material: Lane<u32>,
        /// Whether that is diffuse.
        plain: Lane<u32>,
        /// Whether it is one of those that [`super::kinds::Kinds`] has.
        sorted: Lane<u32>,
        /// Whether it is seen from both sides.
        both: Lane<u32>,
        /// Whether it is the back of a material that is another one there.
        back: Lane<u32>,
        /// One; minus one behind what is seen from both sides.
        side: Lane<P>,
        /// Whether it scatters along deltas only.
        delta: Lane<u32>,
        /// Whether the log differentiates its material.
        differentiated: Lane<u32>,
        /// Whether the change of its normals has samples of its own.
        splits: Lane<u32>,
        /// Whether light is looked for.
        lit: Lane<u32>,
        /// One more than the index of the densities that lead scattered directions; zero if none do.
        guide: Lane<u32>,
        /// How far rays start off the surface.
        offset: Lane<f32>,
        /// The surface that they cannot meet again.
        surface: Lane<u32>,
        /// Albedo of what is plain.
        albedo: Lanes<P>,
        /// Position.
        p: Lanes<P>,
        /// Geometric normal.
        n_geo: Lanes<P>,
        /// Shading frame.
        s: Lanes<P>,
        /// Shading frame.
        t: Lanes<P>,
        /// Shading frame.
        n: Lanes<P>,
        /// Surface coordinate.
        u: Lane<P>,
        /// Surface coordinate.
        v: Lane<P>,
    }
}

/// The bit of [`PathInterest::bent`].
const BENT: u32 = 2;

impl<P: Float> Paths<P> {
    #[inline(always)]
    pub fn interest(&self, i: usize) -> PathInterest {
        PathInterest {
            active: self.active[i] != 0,
            caustics_excluded: self.caustics_excluded[i] & 1 != 0,
            bent: self.caustics_excluded[i] & BENT != 0,
            caustic: self.caustic[i] & 1 != 0,
            run: Run::from_bits(self.caustic[i] >> 1),
        }
    }

    #[inline(always)]
    pub fn put_interest(&mut self, i: usize, interest: PathInterest) {
        self.active[i] = u32::from(interest.active);
        self.caustics_excluded[i] =
            u32::from(interest.caustics_excluded) | (u32::from(interest.bent) * BENT);
        self.caustic[i] = u32::from(interest.caustic) | interest.run.bits() << 1;
    }
}

impl<P: Float> Vertices<P> {
    #[inline(always)]
    pub fn frame(&self, i: usize) -> Frame<P> {
        Frame {
            s: self.s.vec(i),
            t: self.t.vec(i),
            n: self.n.vec(i),
        }
    }

    #[inline(always)]
    pub fn uv(&self, i: usize) -> Vec2<P> {
        Vec2::new(self.u[i], self.v[i])
    }

    /// From where a path along `d` sees vertex `i`, in the local frame of the side that is seen.
    #[inline(always)]
    pub fn seen_along(&self, i: usize, d: Vec3<P>) -> Vec3<P> {
        let wo = self.frame(i).to_local(-d);
        let behind = (self.both[i] != 0) & (wo.z < P::zero());
        seen_from(P::select(behind, -P::one(), P::one()), wo)
    }

    #[inline(always)]
    pub fn exit(&self, i: usize) -> Exit {
        Exit {
            offset: self.offset[i],
            surface: self.surface[i],
        }
    }

    #[inline(always)]
    pub fn interaction(&self, i: usize) -> SurfaceInteraction<P> {
        SurfaceInteraction {
            p: self.p.vec(i),
            t: P::zero(),
            n_geo: self.n_geo.vec(i),
            frame: self.frame(i),
            uv: self.uv(i),
        }
    }

    #[inline(always)]
    pub fn put(&mut self, i: usize, si: &SurfaceInteraction<P>) {
        self.p.put_vec(i, si.p);
        self.n_geo.put_vec(i, si.n_geo);
        self.s.put_vec(i, si.frame.s);
        self.t.put_vec(i, si.frame.t);
        self.n.put_vec(i, si.frame.n);
        (self.u[i], self.v[i]) = (si.uv.x, si.uv.y);
    }

    /// [`Vertices::put`] if `there`, without a branch.
    #[inline(always)]
    pub fn put_if(&mut self, there: bool, i: usize, si: &SurfaceInteraction<P>) {
        let vec = |lanes: &mut Lanes<P>, v: Vec3<P>| {
            lanes.put_vec(i, Vec3::select(there, v, lanes.vec(i)));
        };
        vec(&mut self.p, si.p);
        vec(&mut self.n_geo, si.n_geo);
        vec(&mut self.s, si.frame.s);
        vec(&mut self.t, si.frame.t);
        vec(&mut self.n, si.frame.n);
        self.u[i] = P::select(there, si.uv.x, self.u[i]);
        self.v[i] = P::select(there, si.uv.y, self.v[i]);
    }
}

lanes! {
    /// Samples of emitters.
    Lights {
        /// Index of the emitter.
        emitter: Lane<u32>,
        /// Its share of all samples; zero where none is wanted, or once there is one.
        share: Lane<P>,
        /// Direction to it, world space.
        d: Lanes<P>,
        /// How far away it is.
        distance: Lane<P>,
        /// The surface that it lies on.
        surface: Lane<u32>,
        /// Density; zero if there is no sample.
        pdf: Lane<P>,
        /// One over the probability that it was kept.
        kept: Lane<P>,
        /// Of the emission.
        falloff: Lane<P>,
        /// Where it is emitted.
        u: Lane<P>,
        /// Where it is emitted.
        v: Lane<P>,
        /// Direction to it, local frame.
        wi: Lanes<P>,
        /// Value of the BSDF.
        f: Lanes<P>,
        /// Its density.
        pdf_bsdf: Lane<P>,
        /// Value of the BSDF of what is plain, if it were white.
        white: Lane<P>,
        /// Emitted radiance.
        le: Lanes<P>,
        /// MIS weight over density.
        weight: Lane<P>,
        /// The same for the change of normals, where that has samples of its own.
        normals_weight: Lane<P>,
        /// What arrives at the start of the path, if nothing is in between.
        direct: Lanes<P>,
        /// Origin of the shadow ray.
        shadow_o: Lanes<P>,
        /// Its direction.
        shadow_d: Lanes<P>,
        /// Its length; zero if there is none, or if it was not free.
        shadow_t: Lane<P>,
    }
}

impl<P: Float> Lights<P> {
    #[inline(always)]
    pub fn put(
        &mut self,
        i: usize,
        (emitter, kept): (u32, P),
        share: P,
        sample: Option<EmitterSample<P>>,
    ) {
        let zero = P::zero();
        let none = (Vec3::zero(), zero, NOWHERE, zero, zero, Vec2::zero());
        let (d, distance, surface, pdf, falloff, uv) = sample.map_or(none, |s| {
            let e = s.emission;
            let pdf = s.pdf * share;
            (s.d, s.distance, s.surface, pdf, e.falloff, e.uv)
        });
        self.emitter[i] = emitter;
        self.kept[i] = kept;
        self.d.put_vec(i, d);
        self.distance[i] = distance;
        self.surface[i] = surface;
        self.pdf[i] = pdf;
        self.falloff[i] = falloff;
        (self.u[i], self.v[i]) = (uv.x, uv.y);
    }

    /// Whether path `i` wants a sample and has none.
    #[inline(always)]
    pub fn wants(&self, i: usize) -> bool {
        (self.share[i] > P::zero()) & (self.pdf[i] == P::zero())
    }

    /// Path `i` gets this sample of emitter `index`, if it wants one of that and `right` says so: without a branch, for loops
    /// over many.
    #[inline(always)]
    pub fn take(&mut self, i: usize, index: u32, right: bool, s: &EmitterSample<P>) {
        let (uv, falloff, share) = (s.emission.uv, s.emission.falloff, self.share[i]);
        let takes = (self.emitter[i] == index) & (share > P::zero()) & right;
        self.d.put_vec(i, Vec3::select(takes, s.d, self.d.vec(i)));
        self.distance[i] = P::select(takes, s.distance, self.distance[i]);
        self.surface[i] = if takes { s.surface } else { self.surface[i] };
        self.pdf[i] = P::select(takes, s.pdf * share, self.pdf[i]);
        self.falloff[i] = P::select(takes, falloff, self.falloff[i]);
        self.u[i] = P::select(takes, uv.x, self.u[i]);
        self.v[i] = P::select(takes, uv.y, self.v[i]);
        self.share[i] = P::select(takes, P::zero(), share);
    }

    #[inline(always)]
    pub fn emission(&self, i: usize) -> Emission<P> {
        Emission {
            uv: Vec2::new(self.u[i], self.v[i]),
            falloff: self.falloff[i],
        }
    }
}

lanes! {
    /// Scattered directions.
    Bounces {
        /// Local frame.
        wi: Lanes<P>,
        /// Value of the BSDF.
        f: Lanes<P>,
        /// That of what is plain, if it were white.
        white: Lane<P>,
        /// One over density.
        weight: Lane<P>,
        /// One over the probability of surviving.
        inverse_survival: Lane<P>,
        /// Whether the path goes on.
        continues: Lane<u32>,
    }
}
