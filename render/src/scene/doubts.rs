//! What derivatives miss, by name: where it is not told how shapes cross, and where tilted normals turn away.

use super::Scene;
use crate::edges::crossing::Doubt;
use crate::params::{ParamInfo, ParamKind, ParamRef};

impl Scene {
    /// What no estimator sees of parameters that tilt normals, in a sentence about the first of them: where a normal turns from
    /// its viewer light is cut off, or the normal is flipped, and that line moves ([`crate::bsdf::Tilted`]).
    pub fn doubts_of_tilts(wanted: &[&ParamInfo]) -> Vec<String> {
        let mut tilts = wanted.iter().filter(|i| i.kind == ParamKind::Normals);
        let Some(first) = tilts.next() else {
            return Vec::new();
        };
        let others = match tilts.count() {
            0 => String::new(),
            more => format!("; so it is with {more} more"),
        };
        vec![format!(
            "`{}` tilts normals: what changes where one turns from its viewer is missing in its derivatives, which \
             steep normals make wrong (`check` tells){others}",
            first.name
        )]
    }

    /// Where samples of edges may be wrong, as these parameters move shapes or the camera: pairs of shapes that meet in a way
    /// in which it is not told how they cross. A sentence for each of these ways, about the first pair. Lamps stand out from
    /// what they lie on. All pairs of shapes are looked at, as edges do.
    pub fn doubts_of_crossings(&self, moving: &[&ParamInfo]) -> Vec<String> {
        let moving = moving.iter().filter(|info| info.kind.is_motion());
        let moving: Vec<ParamRef> = moving.map(|info| self.params.handle(info)).collect();
        if moving.is_empty() {
            return Vec::new();
        }
        let moves = |p: ParamRef| moving.contains(&p);
        let camera = self.camera.depends_on(moves);
        let matters = |doubt: Doubt, pair: [u32; 2]| {
            let reads = |&(shape, p): &(u32, ParamRef)| pair.contains(&shape) && moves(p);
            let lamp = doubt == Doubt::Twice && pair.iter().any(|&shape| self.is_lamp(shape));
            !lamp && (camera || self.movers().iter().any(reads))
        };
        let of = |doubt: Doubt| {
            let all = self.crossings().doubts().iter();
            let mut pairs =
                all.filter_map(|&(d, pair)| (d == doubt && matters(d, pair)).then_some(pair));
            let [a, b] = pairs.next()?.map(|shape| &self.shape_info(shape).name);
            let meet = if a == b {
                format!("two parts of `{a}`")
            } else {
                format!("`{a}` and `{b}`")
            };
            let others = match pairs.count() {
                0 => String::new(),
                more => format!("; so it is with {more} more pairs"),
            };
            Some(format!(
                "{meet} {}: derivatives in where they are may be wrong there{others}",
                doubt.describe()
            ))
        };
        Doubt::ALL.into_iter().filter_map(of).collect()
    }
}
