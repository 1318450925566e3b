//! Meshes whose points are displaced along their normals by a texture.

use ad_core::{Const, Float, Real, Vec2, Vec3};

use super::mesh_data::{MeshData, smooth_normals};
use super::welding::Welding;
use crate::math::each;
use crate::params::{GradSink, ParamRef, Params, Theta};
use crate::texture::ScalarTexture;

/// Where texels lie: any height that a coordinate has room for, up or down.
pub const HEIGHTS: (f64, f64) = (-1e9, 1e9);

/// How the points of a mesh are displaced: `x = base + d n`, where `n` is the unit normal of the undisplaced mesh, and `d` a
/// linear function of the texels.
#[derive(Debug)]
pub(super) struct Displacement {
    pub param: ParamRef,
    /// Per point, where it is without.
    base: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    /// Per point, where its texels begin.
    starts: Vec<u32>,
    /// Texels, each once per point, and their weights.
    terms: Vec<(u32, f32)>,
}

impl Displacement {
    /// Of the points that vertices are. Where several vertices are one point, along a seam of texture coordinates, it is
    /// displaced by the mean of what the texture has for them: nothing tears. Normals are weighted by angles, over all
    /// triangles around a point.
    pub fn new(
        mesh: &MeshData,
        flip: bool,
        welding: &Welding,
        texture: &ScalarTexture,
    ) -> Option<Self> {
        let mut param = None;
        texture.visit_params(&mut |p| param = Some(p));
        let count = welding.firsts.len();
        let mut found = vec![Vec::<(u32, f32)>::new(); count];
        let mut vertices = vec![0u32; count];
        for (i, &[u, v]) in mesh.uvs.iter().enumerate() {
            let point = welding.points[i] as usize;
            vertices[point] += 1;
            let at = Vec2::new(f64::from(u), f64::from(v));
            let footprint = texture.footprint(at);
            for (texel, weight) in footprint.texel.into_iter().zip(footprint.weight) {
                let known = found[point].iter_mut().find(|(t, _)| *t == texel);
                match known {
                    _ if weight == 0.0 => {}
                    Some((_, w)) => *w += weight as f32,
                    None => found[point].push((texel, weight as f32)),
                }
            }
        }
        let mut starts = vec![0];
        let mut terms = Vec::new();
        for (own, n) in found.into_iter().zip(vertices) {
            terms.extend(
                own.into_iter()
                    .map(|(texel, w)| (texel, w / n.max(1) as f32)),
            );
            starts.push(terms.len() as u32);
        }
        let base: Vec<[f32; 3]> = (welding.firsts.iter())
            .map(|&i| mesh.positions[i as usize])
            .collect();
        let normals = smooth_normals(&base, &welding.triangles(mesh));
        let side = if flip { -1.0 } else { 1.0 };
        Some(Self {
            param: param?,
            normals: normals.into_iter().map(|n| each(n, |x| side * x)).collect(),
            base,
            starts,
            terms,
        })
    }

    fn terms(&self, point: u32) -> &[(u32, f32)] {
        let [from, to] = [0, 1].map(|k| self.starts[point as usize + k] as usize);
        &self.terms[from..to]
    }

    /// Where a point is.
    pub fn position(&self, params: &Params, point: u32) -> [f32; 3] {
        let texels = &params.values()[self.param.offset as usize..];
        let height: f64 = (self.terms(point).iter())
            .map(|&(texel, w)| f64::from(w) * f64::from(texels[texel as usize]))
            .sum();
        let [base, n] = [&self.base, &self.normals].map(|v| v[point as usize]);
        each([0, 1, 2], |k: usize| {
            (f64::from(base[k]) + height * f64::from(n[k])) as f32
        })
    }

    /// How it moves.
    pub fn offset<R: Real>(&self, theta: &Theta<R>, point: u32) -> [R; 3] {
        let mut rises = R::zero();
        for &(texel, w) in self.terms(point) {
            let x = theta.get(self.param, texel as usize);
            rises += (x - Const(x.primal())) * R::c(w.into());
        }
        each(self.normals[point as usize], |n| rises * R::c(n.into()))
    }

    /// The transpose of that.
    pub fn add<P: Float>(&self, point: u32, d: [P; 3], grad: &mut impl GradSink<P>) {
        let n: Vec3<P> = each(self.normals[point as usize], |x| P::of(x.into())).into();
        let along = n.dot(d.into());
        for &(texel, w) in self.terms(point) {
            grad.add(self.param, texel as usize, along * P::of(w.into()));
        }
    }
}
