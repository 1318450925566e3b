//! Where it is not told how shapes cross, by name.

use super::Scene;
use crate::edges::crossing::Doubt;
use crate::params::{ParamInfo, ParamRef};

impl Scene {
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
            let others = match pairs.count() {
                0 => String::new(),
                more => format!("; so it is with {more} more pairs"),
            };
            Some(format!(
                "`{a}` and `{b}` {}: derivatives in where they are may be wrong there{others}",
                doubt.describe()
            ))
        };
        Doubt::ALL.into_iter().filter_map(of).collect()
    }
}
