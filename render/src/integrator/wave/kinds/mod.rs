//! Vertices of one kind of material, at once.
//!
//! What vertices of a kind are made of is [`Members`]: numbers that are gathered where paths arrive, and loops over them
//! that answer what light from a direction is worth, or where to go on. [`Sorted`] knows which paths they are of, and
//! [`Leaves`] have all kinds. A kind is a file with its `Members`, a field of `Leaves`, and a line where these sort. What is
//! made of others is [`Composites`], over the kinds of its parts.

mod composites;
mod diffuse;
mod facets;
mod glass;
mod metals;
mod plastics;
mod rough_glass;
mod rough_plastics;

use ad_core::{Float, Vec3};
use composites::Composites;
use diffuse::Matt;
use glass::Glass;
use metals::Metals;
use plastics::Plastics;
use rough_glass::RoughGlass;
use rough_plastics::RoughPlastics;

use super::lanes::{Field, Lane, Lanes, WAVE_SIZE, lanes};
use crate::bsdf::microfacet::Ndf;
use crate::bsdf::{Component, DeltaKind, Material, Shading};
use crate::math::Rgb;

/// What is seen of a material: one side of it, and whether directions have to be turned to its front where they are
/// behind. `behind` is asked only where that is not the same.
#[inline(always)]
pub fn side(material: &Material, behind: bool) -> (&Material, bool) {
    match material {
        Material::TwoSided(m) => (&m.sides()[usize::from(behind)], true),
        _ => (material, false),
    }
}

/// Whether a material is another one from behind.
#[inline(always)]
pub fn has_two_sides(material: &Material) -> bool {
    matches!(material, Material::TwoSided(m) if m.same().is_none())
}

/// A direction in the local frame of the side that is seen: `side` is one, or minus one from behind.
#[inline(always)]
pub fn seen_from<P: Float>(side: P, w: Vec3<P>) -> Vec3<P> {
    Vec3::new(w.x, w.y, w.z * side)
}

/// What a sampled direction belongs to, as a number.
const CONTINUOUS: u32 = 0;
const REFLECTED: u32 = 1;
const TRANSMITTED: u32 = 2;

#[inline(always)]
fn component(number: u32) -> Component {
    let delta = |kind| Component::Delta { kind, route: 0 };
    match number {
        REFLECTED => delta(DeltaKind::Reflection),
        TRANSMITTED => delta(DeltaKind::Transmission),
        _ => Component::Continuous,
    }
}

lanes! {
    /// What members of a kind are asked, and what they answer. Directions are in the local frame of the side that is seen.
    Scattering {
        /// Direction that the path came from.
        wo: Lanes<P>,
        /// Direction to the light, or scattered one.
        wi: Lanes<P>,
        /// Random numbers.
        u: Lanes<P>,
        /// Value there.
        f: Lanes<P>,
        /// Density, or probability of a delta; zero where nothing is scattered.
        pdf: Lane<P>,
        /// Relative index on the new side.
        eta: Lane<P>,
        /// What the direction belongs to: [`component`].
        component: Lane<u32>,
        /// Whether anything depends on the answer.
        asked: Lane<u32>,
        /// Whether the direction is right.
        sampled: Lane<u32>,
        /// Whether all is right; otherwise, the functions of the vertex have to be called.
        right: Lane<u32>,
    }
}

/// The members of a kind that a loop goes over.
#[derive(Clone, Copy, Debug)]
struct Among<'a> {
    /// How many there are.
    n: usize,
    /// Those whose normals have no step in vectors: they are found one by one.
    one_by_one: &'a [usize],
}

/// What vertices of one kind of material are made of, and what they make of light.
trait Members<P: Float> {
    /// Whether light that is sampled means anything to them.
    const CONNECTS: bool;
    /// None.
    fn new() -> Self;
    /// Takes in a material at a point as the `k`-th. The distribution of its normals; without normals, that of those that
    /// have steps in vectors. `None` if it is none of these there.
    fn gather(&mut self, k: usize, material: &Material, at: &Shading<P>) -> Option<Ndf>;
    /// Value, density, and whether they are right, of the directions `wi`.
    fn eval_pdf(&mut self, among: Among, of: &mut Scattering<P>);
    /// The same of directions that are made of the random numbers.
    fn sample(&mut self, among: Among, of: &mut Scattering<P>);
}

/// The vertices of a wave that are of one kind.
struct Sorted<M> {
    /// Which paths stand there.
    paths: Vec<usize>,
    /// Those of [`Among::one_by_one`], by their places among these.
    one_by_one: Vec<usize>,
    /// Made when there are any.
    members: Option<Box<M>>,
}

/// What a vertex scatters: direction, value, density or probability, what it belongs to, and the relative index there.
pub type Found<P> = (Vec3<P>, Rgb<P>, P, Component, P);

impl<M> Sorted<M> {
    fn new() -> Self {
        Self {
            paths: Vec::with_capacity(WAVE_SIZE),
            one_by_one: Vec::with_capacity(WAVE_SIZE),
            members: None,
        }
    }

    fn clear(&mut self) {
        self.paths.clear();
        self.one_by_one.clear();
    }

    /// Takes path `i` in, if the material is one of these there.
    #[inline(always)]
    fn take<P: Float>(&mut self, i: usize, material: &Material, at: &Shading<P>) -> bool
    where
        M: Members<P>,
    {
        let k = self.paths.len() % WAVE_SIZE;
        let members = self.members.get_or_insert_with(|| Box::new(M::new()));
        match members.gather(k, material, at) {
            None => return false,
            Some(Ndf::Ggx) => {}
            Some(Ndf::Beckmann) => self.one_by_one.push(k),
        }
        self.paths.push(i);
        true
    }

    /// See [`Kinds::eval_pdf`].
    #[inline(always)]
    fn eval_pdf<P: Float>(
        &mut self,
        of: &mut Scattering<P>,
        (wo, side, wi): (&Lanes<P>, &Lane<P>, &Lanes<P>),
        put: &mut impl FnMut(usize, Option<(Rgb<P>, P)>),
    ) where
        M: Members<P>,
    {
        let Some(members) = self.members.as_mut().filter(|_| !self.paths.is_empty()) else {
            return;
        };
        if !M::CONNECTS {
            for &i in &self.paths {
                put(i, Some((Rgb::black(), P::zero())));
            }
            return;
        }
        for (k, &i) in self.paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            of.wo.put_vec(k, seen_from(side[i], wo.vec(i)));
            of.wi.put_vec(k, seen_from(side[i], wi.vec(i)));
            of.asked[k] = 1;
        }
        let (n, one_by_one) = (self.paths.len(), &self.one_by_one[..]);
        members.eval_pdf(Among { n, one_by_one }, of);
        for (k, &i) in self.paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            put(i, (of.right[k] != 0).then(|| (of.f.rgb(k), of.pdf[k])));
        }
    }

    /// See [`Kinds::sample`].
    #[inline(always)]
    fn sample<P: Float>(
        &mut self,
        of: &mut Scattering<P>,
        (wo, side, [a, b, c]): (&Lanes<P>, &Lane<P>, [&Lane<P>; 3]),
        asked: &impl Fn(usize) -> bool,
        put: &mut impl FnMut(usize, Option<Found<P>>),
    ) where
        M: Members<P>,
    {
        let Some(members) = self.members.as_mut().filter(|_| !self.paths.is_empty()) else {
            return;
        };
        for (k, &i) in self.paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            of.wo.put_vec(k, seen_from(side[i], wo.vec(i)));
            of.u.put_vec(k, Vec3::new(a[i], b[i], c[i]));
            of.asked[k] = u32::from(asked(i));
        }
        let (n, one_by_one) = (self.paths.len(), &self.one_by_one[..]);
        members.sample(Among { n, one_by_one }, of);
        for (k, &i) in self.paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            let wi = seen_from(side[i], of.wi.vec(k));
            let component = component(of.component[k]);
            let all = || (wi, of.f.rgb(k), of.pdf[k], component, of.eta[k]);
            put(i, (of.right[k] & of.sampled[k] != 0).then(all));
        }
    }
}

/// The kinds of materials that are made of nothing else.
#[derive(Clone, Copy, Debug)]
enum Sort {
    Diffuse,
    Metal,
    Glass,
    RoughGlass,
    Plastic,
    RoughPlastic,
}

/// Which of them a material is, if it is one. Where not only visible normals are sampled, it is none.
#[inline(always)]
fn sort(material: &Material) -> Option<Sort> {
    match material {
        Material::Diffuse(_) => Some(Sort::Diffuse),
        Material::RoughConductor(m) if m.roughness.visible => Some(Sort::Metal),
        Material::Conductor(_) => Some(Sort::Metal),
        Material::Dielectric(_) | Material::ThinDielectric(_) => Some(Sort::Glass),
        Material::RoughDielectric(m) if m.roughness.visible => Some(Sort::RoughGlass),
        Material::Plastic(_) => Some(Sort::Plastic),
        Material::RoughPlastic(m) if m.roughness.visible => Some(Sort::RoughPlastic),
        _ => None,
    }
}

/// Vertices by the kinds of their materials, which are made of nothing else.
struct Leaves<P> {
    of: Box<Scattering<P>>,
    diffuse: Sorted<Matt<P>>,
    metals: Sorted<Metals<P>>,
    glass: Sorted<Glass<P>>,
    rough_glass: Sorted<RoughGlass<P>>,
    plastics: Sorted<Plastics<P>>,
    rough_plastics: Sorted<RoughPlastics<P>>,
}

impl<P: Float> Leaves<P> {
    fn new() -> Self {
        Self {
            of: Box::new(Scattering::zero()),
            diffuse: Sorted::new(),
            metals: Sorted::new(),
            glass: Sorted::new(),
            rough_glass: Sorted::new(),
            plastics: Sorted::new(),
            rough_plastics: Sorted::new(),
        }
    }

    fn clear(&mut self) {
        self.diffuse.clear();
        self.metals.clear();
        self.glass.clear();
        self.rough_glass.clear();
        self.plastics.clear();
        self.rough_plastics.clear();
    }

    /// Takes number `i` in, if its material is one of these there.
    #[inline(always)]
    fn take(&mut self, i: usize, material: &Material, at: &Shading<P>) -> bool {
        match sort(material) {
            Some(Sort::Diffuse) => self.diffuse.take(i, material, at),
            Some(Sort::Metal) => self.metals.take(i, material, at),
            Some(Sort::Glass) => self.glass.take(i, material, at),
            Some(Sort::RoughGlass) => self.rough_glass.take(i, material, at),
            Some(Sort::Plastic) => self.plastics.take(i, material, at),
            Some(Sort::RoughPlastic) => self.rough_plastics.take(i, material, at),
            None => false,
        }
    }

    /// As [`Kinds::eval_pdf`].
    #[inline(always)]
    fn eval_pdf(
        &mut self,
        wo: &Lanes<P>,
        side: &Lane<P>,
        wi: &Lanes<P>,
        put: &mut impl FnMut(usize, Option<(Rgb<P>, P)>),
    ) {
        let (of, directions) = (&mut *self.of, (wo, side, wi));
        self.diffuse.eval_pdf(of, directions, put);
        self.metals.eval_pdf(of, directions, put);
        self.glass.eval_pdf(of, directions, put);
        self.rough_glass.eval_pdf(of, directions, put);
        self.plastics.eval_pdf(of, directions, put);
        self.rough_plastics.eval_pdf(of, directions, put);
    }

    /// As [`Kinds::sample`]; answers are right where `asked` holds.
    #[inline(always)]
    fn sample(
        &mut self,
        wo: &Lanes<P>,
        side: &Lane<P>,
        numbers: [&Lane<P>; 3],
        asked: impl Fn(usize) -> bool,
        put: &mut impl FnMut(usize, Option<Found<P>>),
    ) {
        let (of, from) = (&mut *self.of, (wo, side, numbers));
        self.diffuse.sample(of, from, &asked, put);
        self.metals.sample(of, from, &asked, put);
        self.glass.sample(of, from, &asked, put);
        self.rough_glass.sample(of, from, &asked, put);
        self.plastics.sample(of, from, &asked, put);
        self.rough_plastics.sample(of, from, &asked, put);
    }
}

/// The vertices of a wave, by the kinds of their materials: all but those that are diffuse.
pub struct Kinds<P> {
    leaves: Leaves<P>,
    /// Made when there are any.
    composites: Option<Box<Composites<P>>>,
}

impl<P: Float> Kinds<P> {
    /// Without vertices.
    pub fn new() -> Self {
        Self {
            leaves: Leaves::new(),
            composites: None,
        }
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.leaves.clear();
        if let Some(composites) = &mut self.composites {
            composites.clear();
        }
    }

    /// Takes path `i` in, if its material is one of these there; `wo`, from where the path came to the side that is seen,
    /// is asked only where a material is made of others.
    #[inline(never)]
    pub fn take(
        &mut self,
        i: usize,
        material: &Material,
        at: &Shading<P>,
        wo: impl FnOnce() -> Vec3<P>,
    ) -> bool {
        if composites::may_be_one(material) {
            let composites = self.composites.get_or_insert_with(Default::default);
            return composites.take(i, material, at, wo());
        }
        self.leaves.take(i, material, at)
    }

    /// Values and densities of directions to lights: calls `put` with each path, and with them where they are right.
    #[inline(never)]
    pub fn eval_pdf(
        &mut self,
        wo: &Lanes<P>,
        side: &Lane<P>,
        wi: &Lanes<P>,
        mut put: impl FnMut(usize, Option<(Rgb<P>, P)>),
    ) {
        self.leaves.eval_pdf(wo, side, wi, &mut put);
        if let Some(composites) = &mut self.composites {
            composites.eval_pdf((wo, side, wi), &mut put);
        }
    }

    /// Scattered directions, made of three lanes of random numbers: calls `put` with each path, and with what it finds
    /// where that is right.
    #[inline(never)]
    pub fn sample(
        &mut self,
        wo: &Lanes<P>,
        side: &Lane<P>,
        numbers: [&Lane<P>; 3],
        mut put: impl FnMut(usize, Option<Found<P>>),
    ) {
        self.leaves.sample(wo, side, numbers, |_| true, &mut put);
        if let Some(composites) = &mut self.composites {
            composites.sample((wo, side, numbers), &mut put);
        }
    }
}
