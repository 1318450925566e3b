//! Derivatives by the importance solution.

use ad_core::Dual;

use super::element::Kind;
use super::solve::{Field, Flow, Table};
use super::{FiniteElementError, FiniteElements};
use crate::bsdf::Bsdf;
use crate::emitter::Emitter;
use crate::error::RenderError;
use crate::estimator::{DetachedMis, check_parameter};
use crate::params::{ParamShape, Tangent, Theta};

/// The derivative of the cost in one range of parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterGradient {
    /// Its name.
    pub name: String,
    /// One number per value.
    pub values: Vec<f64>,
}

/// Why there is no gradient.
#[derive(Debug, thiserror::Error)]
pub enum GradientError {
    /// No such parameter.
    #[error(transparent)]
    Parameter(#[from] RenderError),
    /// A table that cannot be made.
    #[error(transparent)]
    Solver(#[from] FiniteElementError),
}

impl FiniteElements<'_> {
    /// The derivatives of [`FiniteElements::cost`] in all values of the named ranges, from the current
    /// solution: `dJ = <Lambda, dE + dR G L>` with the importance `Lambda` that arrives [Stam, Eq. 12-14].
    /// Elements and links are held fixed; accurate to the tolerance of the solution.
    ///
    /// # Errors
    /// A name that the scene does not have.
    pub fn gradient(&self, names: &[&str]) -> Result<Vec<ParameterGradient>, GradientError> {
        let t = self.operator();
        let mut arriving = t.incident(&self.importance, Flow::Importance);
        for (a, m) in arriving.iter_mut().zip(self.measured()) {
            (0..3).for_each(|c| a[c] += m[c]);
        }
        let light = t.incident(&self.radiance, Flow::Radiance);
        names
            .iter()
            .map(|name| self.derivative(name, &arriving, &light))
            .collect()
    }

    fn derivative(
        &self,
        name: &str,
        arriving: &Field,
        light: &Field,
    ) -> Result<ParameterGradient, GradientError> {
        let params = self.scene.params();
        let info = params.find(name)?;
        if info.kind.is_motion() {
            check_parameter::<DetachedMis>(info)?;
        }
        let handle = params.handle(info);
        let mut tangents = vec![Tangent::None; params.infos().len()];
        tangents[handle.id as usize] = Tangent::Uniform(Dual::<f64, 1>::new(0.0, [1.0]));
        let theta = Theta::with_tangents(&self.theta, &tangents);
        let mut sum = [0.0; 3];

        // dR G L, where the material reads the range.
        let tables: Vec<Table> = (self.sides.iter())
            .map(|side| {
                let mut reads = false;
                let material = &self.scene.materials()[side.material as usize];
                material.visit_params(&mut |p| reads |= p == handle);
                if reads {
                    let values = self.reflection::<Dual<f64, 1>>(&theta, side);
                    let tangents: Vec<_> = values.iter().map(|f| f.map(|x| x.eps[0])).collect();
                    self.table(&tangents)
                } else {
                    let n = self.basis(side).len();
                    Table {
                        nodes: n,
                        values: vec![[0.0; 3]; n * n],
                        albedo: [0.0; 3],
                        distance: Vec::new(),
                    }
                }
            })
            .collect();
        let t = self.operator();
        let change = t.push_pull(&t.apply(light, &tables));
        for (a, l) in arriving.iter().zip(&change) {
            (0..3).for_each(|c| sum[c] += a[c] * l[c]);
        }

        // dE, over links and directly.
        let reads = |e: u32| {
            let texture = self.scene.emitters()[e as usize].radiance();
            texture.any_param(|p| p == handle)
        };
        for (e, _) in self.mesh.elements.iter().enumerate() {
            if let Kind::Lamp(emitter) = self.mesh.root(e as u32).kind
                && reads(emitter)
            {
                let a = arriving[self.mesh.start[e]];
                (0..3).for_each(|c| sum[c] += a[c]);
            }
        }
        let weight = 1.0 / (3.0 * self.pixels.len().max(1) as f64);
        for (emitter, lobe) in self.pixels.iter().flatten().filter_map(|p| p.lamp) {
            if reads(emitter) {
                (0..3).for_each(|c| sum[c] += weight * lobe);
            }
        }
        let values = match info.shape {
            ParamShape::Rgb => sum.to_vec(),
            // What supported models read is constant: other shapes have no influence.
            _ => vec![sum.iter().sum(); info.shape.len()],
        };
        Ok(ParameterGradient {
            name: name.into(),
            values,
        })
    }
}
