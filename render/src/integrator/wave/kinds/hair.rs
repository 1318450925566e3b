//! Hair.

use ad_core::{Float, Vec3};

use super::super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::super::readings::Reading;
use super::{CONTINUOUS, Members, Scattering};
use crate::bsdf::{Along, Around, Fibre, HairLobe, Material, Seen};

lanes! {
    /// Fibres, what follows from them, and what is seen of them. Numbers of R, TT and TRT are vectors.
    Fibres {
        sigma_a: Lanes<P>,
        eta: Lane<P>,
        longitudinal: Lane<P>,
        azimuthal: Lane<P>,
        scale_tilt: Lane<P>,
        /// [`HairLobe`].
        variance: Lanes<P>,
        along: Lanes<P>,
        scale: Lane<P>,
        around: Lane<P>,
        tilt_sin: Lanes<P>,
        tilt_cos: Lanes<P>,
        /// [`Seen`].
        sin: Lane<P>,
        cos: Lane<P>,
        gamma: Lane<P>,
        inside: Lane<P>,
        r: Lanes<P>,
        tt: Lanes<P>,
        trt: Lanes<P>,
        rest: Lanes<P>,
    }
}

/// Hair.
pub struct Hairs<P> {
    lanes: Fibres<P>,
    /// Whether [`Hairs::prepare`] and [`Hairs::see`] have been called for these.
    prepared: bool,
}

impl<P: Float> Hairs<P> {
    #[inline(always)]
    fn at(&self, k: usize) -> HairLobe<P> {
        let lanes = &self.lanes;
        let (variance, norm) = (lanes.variance.vec(k), lanes.along.vec(k));
        let (sin, cos) = (lanes.tilt_sin.vec(k), lanes.tilt_cos.vec(k));
        HairLobe {
            sigma_a: lanes.sigma_a.rgb(k),
            eta: lanes.eta[k],
            along: [
                Along {
                    variance: variance.x,
                    norm: norm.x,
                },
                Along {
                    variance: variance.y,
                    norm: norm.y,
                },
                Along {
                    variance: variance.z,
                    norm: norm.z,
                },
            ],
            around: Around {
                scale: lanes.scale[k],
                norm: lanes.around[k],
            },
            tilts: [[sin.x, cos.x], [sin.y, cos.y], [sin.z, cos.z]],
        }
    }

    #[inline(always)]
    fn seen(&self, k: usize) -> Seen<P> {
        let lanes = &self.lanes;
        Seen {
            theta: [lanes.sin[k], lanes.cos[k]],
            gamma: lanes.gamma[k],
            inside: lanes.inside[k],
            attenuation: [
                lanes.r.rgb(k),
                lanes.tt.rgb(k),
                lanes.trt.rgb(k),
                lanes.rest.rgb(k),
            ],
        }
    }

    /// What follows from the parameters alone, once for those that were gathered.
    #[inline(never)]
    fn prepare(&mut self, n: usize) {
        let lanes = &mut self.lanes;
        for k in 0..whole(n) {
            let lobe = HairLobe::new_in_line(&Fibre {
                sigma_a: lanes.sigma_a.rgb(k),
                roughness: [lanes.longitudinal[k], lanes.azimuthal[k]],
                scale_tilt: lanes.scale_tilt[k],
                eta: lanes.eta[k],
            });
            let [r, tt, trt] = lobe.along;
            let variance = Vec3::new(r.variance, tt.variance, trt.variance);
            lanes.variance.put_vec(k, variance);
            (lanes.along).put_vec(k, Vec3::new(r.norm, tt.norm, trt.norm));
            (lanes.scale[k], lanes.around[k]) = (lobe.around.scale, lobe.around.norm);
            let [r, tt, trt] = lobe.tilts;
            lanes.tilt_sin.put_vec(k, Vec3::new(r[0], tt[0], trt[0]));
            lanes.tilt_cos.put_vec(k, Vec3::new(r[1], tt[1], trt[1]));
        }
    }

    /// The side of the viewers.
    #[inline(never)]
    fn see(&mut self, n: usize, of: &Scattering<P>) {
        for k in 0..whole(n) {
            let seen = self.at(k).seen_in_line(of.wo.vec(k));
            let lanes = &mut self.lanes;
            [lanes.sin[k], lanes.cos[k]] = seen.theta;
            (lanes.gamma[k], lanes.inside[k]) = (seen.gamma, seen.inside);
            let [r, tt, trt, rest] = seen.attenuation;
            lanes.r.put_rgb(k, r);
            lanes.tt.put_rgb(k, tt);
            lanes.trt.put_rgb(k, trt);
            lanes.rest.put_rgb(k, rest);
        }
    }

    #[inline(never)]
    fn value(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (f, pdf) = self.at(k).eval_pdf_in_line(&self.seen(k), of.wi.vec(k));
            of.f.put_rgb(k, f);
            of.pdf[k] = pdf;
            of.right[k] = 1;
        }
    }

    #[inline(never)]
    fn turn(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (lobe, seen, u) = (self.at(k), self.seen(k), of.u.vec(k));
            let wi = lobe.scatter_in_line(&seen, u.to_array());
            of.wi.put_vec(k, wi);
            of.eta[k] = P::one();
            of.component[k] = CONTINUOUS;
            of.sampled[k] = 1;
        }
    }

    /// All there is to know before any direction to a light, once for those that were gathered: `wo` is the same in all calls.
    #[inline(always)]
    fn look(&mut self, n: usize, of: &Scattering<P>) {
        if !self.prepared {
            self.prepare(n);
            self.see(n, of);
            self.prepared = true;
        }
    }
}

impl<P: Float> Members<P> for Hairs<P> {
    const CONNECTS: bool = true;

    fn new() -> Self {
        Self {
            lanes: Fibres::zero(),
            prepared: false,
        }
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, read: &mut Reading<P>) -> bool {
        let Material::Hair(m) = material else {
            return false;
        };
        let fibre = m.fibre(read);
        let lanes = &mut self.lanes;
        lanes.sigma_a.put_rgb(k, fibre.sigma_a);
        [lanes.longitudinal[k], lanes.azimuthal[k]] = fibre.roughness;
        (lanes.scale_tilt[k], lanes.eta[k]) = (fibre.scale_tilt, fibre.eta);
        self.prepared = false;
        true
    }

    #[inline(always)]
    fn repeat(&mut self, k: usize, earlier: usize) {
        self.lanes.relocate(k, earlier);
        self.prepared = false;
    }

    #[inline(always)]
    fn eval_pdf(&mut self, n: usize, of: &mut Scattering<P>) {
        self.look(n, of);
        self.value(n, of);
    }

    #[inline(always)]
    fn sample(&mut self, n: usize, of: &mut Scattering<P>) {
        self.look(n, of);
        self.turn(n, of);
        self.value(n, of);
    }
}
