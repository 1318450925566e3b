//! Vertices of one kind of material, at once.
//!
//! What vertices of a kind are made of is [`Members`]: numbers that are gathered where paths arrive, and loops over them
//! that answer what light from a direction is worth, or where to go on. [`Sorted`] knows which paths they are of, and
//! [`Leaves`] have all kinds. A kind is a file with its `Members`, a field of `Leaves`, and a line where these sort. What is
//! made of others is [`Composites`], over the kinds of its parts.

mod blinn_phong;
mod composites;
mod diffuse;
mod facets;
mod glass;
mod hair;
mod metals;
mod nothing;
mod plastics;
mod principled;
mod principled_thin;
mod rough_glass;
mod rough_plastics;

use ad_core::{Float, Vec3};
use blinn_phong::Phong;
use composites::Composites;
pub use composites::visit_textures;
use diffuse::Matt;
pub use facets::{Beckmann, Ggx, Shape, Surfaces};
use glass::Glass;
use hair::Hairs;
use metals::Metals;
use nothing::Nothing;
use plastics::Plastics;
use principled::PrincipledSurfaces;
use principled_thin::ThinSurfaces;
use rough_glass::RoughGlass;
use rough_plastics::RoughPlastics;

use super::lanes::{Field, Lane, Lanes, WAVE_SIZE, lanes};
use super::readings::Reading;
use crate::bsdf::microfacet::{Axes, Ndf};
use crate::bsdf::{Bsdf, Component, DeltaKind, Material, Roughness};
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
const PASSED: u32 = 3;

#[inline(always)]
fn component(number: u32) -> Component {
    let delta = |kind| Component::Delta { kind, route: 0 };
    match number {
        REFLECTED => delta(DeltaKind::Reflection),
        TRANSMITTED => delta(DeltaKind::Transmission),
        PASSED => delta(DeltaKind::Passthrough),
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
        /// Whether the direction is right.
        sampled: Lane<u32>,
        /// Whether all is right; otherwise, the functions of the vertex have to be called.
        right: Lane<u32>,
    }
}

/// What vertices of one kind of material are made of, and what they make of light.
trait Members<P: Float> {
    /// Whether light that is sampled means anything to them.
    const CONNECTS: bool;
    /// Without members.
    fn new() -> Self;
    /// Takes in a material at a point as the `k`-th, if it is one of these there.
    fn gather(&mut self, k: usize, material: &Material, read: &mut Reading<P>) -> bool;
    /// Makes the `k`-th what an earlier one is: of a material that is the same everywhere.
    fn repeat(&mut self, k: usize, earlier: usize);
    /// Value, density, and whether they are right, of the first `n` directions `wi`.
    fn eval_pdf(&mut self, n: usize, of: &mut Scattering<P>);
    /// The same of directions that are made of the random numbers.
    fn sample(&mut self, n: usize, of: &mut Scattering<P>);
}

/// So many materials of a kind are told apart at once.
const MOST_KNOWN: usize = 8;

/// A material that has been seen.
#[derive(Clone, Copy, Default)]
struct Known {
    /// Its address: materials stay where they are while a wave is followed.
    material: usize,
    /// Whether it is the same everywhere.
    even: bool,
    /// Which of the members is the last one of it, and among which vertices.
    member: usize,
    round: u64,
}

impl Known {
    fn of(material: &Material) -> Self {
        let mut even = true;
        material.visit_textures(&mut |t| even &= t.is_constant());
        Self {
            material: Self::address(material),
            even,
            ..Self::default()
        }
    }

    #[inline(always)]
    fn address(material: &Material) -> usize {
        std::ptr::from_ref(material).addr()
    }
}

/// The vertices of a wave that are of one kind.
struct Sorted<M> {
    /// Which paths stand there.
    paths: Vec<usize>,
    /// Made when there are any.
    members: Option<Box<M>>,
    known: [Known; MOST_KNOWN],
    /// How often they have been forgotten, counted from one.
    round: u64,
}

/// What a vertex scatters: direction, value, density or probability, what it belongs to, and the relative index there.
pub type Found<P> = (Vec3<P>, Rgb<P>, P, Component, P);

/// A path, and value and density of a direction to a light at its vertex, where they are right.
pub type Valued<P> = (usize, Option<(Rgb<P>, P)>);

/// A path, and what its vertex scatters, where that is right.
pub type Scattered<P> = (usize, Option<Found<P>>);

impl<M> Sorted<M> {
    fn new() -> Self {
        Self {
            paths: Vec::new(),
            members: None,
            known: [Known::default(); MOST_KNOWN],
            round: 1,
        }
    }

    /// Forgets all.
    #[inline(always)]
    fn clear(&mut self) {
        self.paths.clear();
        self.round += 1;
    }

    /// Takes path `i` in, if the material is one of these there.
    #[inline(always)]
    fn take<P: Float>(&mut self, i: usize, material: &Material, read: &mut Reading<P>) -> bool
    where
        M: Members<P>,
    {
        let k = self.paths.len() % WAVE_SIZE;
        let members = self.members.get_or_insert_with(|| Box::new(M::new()));
        let address = Known::address(material);
        let known = &mut self.known[(address / size_of::<Material>()) % MOST_KNOWN];
        if known.material != address {
            *known = Known::of(material);
        }
        if known.even & (known.round == self.round) {
            members.repeat(k, known.member);
        } else if members.gather(k, material, read) {
            (known.member, known.round) = (k, self.round);
        } else {
            return false;
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
        out: &mut Vec<Valued<P>>,
    ) where
        M: Members<P>,
    {
        let Some(members) = self.members.as_mut().filter(|_| !self.paths.is_empty()) else {
            return;
        };
        if !M::CONNECTS {
            let nothing = Some((Rgb::black(), P::zero()));
            out.extend(self.paths.iter().map(|&i| (i, nothing)));
            return;
        }
        for (k, &i) in self.paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            of.wo.put_vec(k, seen_from(side[i], wo.vec(i)));
            of.wi.put_vec(k, seen_from(side[i], wi.vec(i)));
        }
        members.eval_pdf(self.paths.len(), of);
        out.extend(self.paths.iter().enumerate().map(|(k, &i)| {
            let k = k % WAVE_SIZE;
            let found = (of.f.rgb(k), of.pdf[k]);
            (i, (of.right[k] != 0).then_some(found))
        }));
    }

    /// See [`Kinds::sample`].
    #[inline(always)]
    fn sample<P: Float>(
        &mut self,
        of: &mut Scattering<P>,
        (wo, side, [a, b, c]): (&Lanes<P>, &Lane<P>, [&Lane<P>; 3]),
        out: &mut Vec<Scattered<P>>,
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
        }
        members.sample(self.paths.len(), of);
        out.extend(self.paths.iter().enumerate().map(|(k, &i)| {
            let k = k % WAVE_SIZE;
            let wi = seen_from(side[i], of.wi.vec(k));
            let component = component(of.component[k]);
            let all = (wi, of.f.rgb(k), of.pdf[k], component, of.eta[k]);
            (i, (of.right[k] & of.sampled[k] != 0).then_some(all))
        }));
    }
}

/// The kinds of materials that are made of nothing else, and their members.
macro_rules! kinds {
    ($($kind:ident $field:ident: $members:ty,)*) => {
        /// The kinds of materials that are made of nothing else.
        #[derive(Clone, Copy, Debug)]
        enum Sort {
            $($kind,)*
        }

        /// Vertices by the kinds of their materials, which are made of nothing else.
        struct Leaves<P> {
            of: Box<Scattering<P>>,
            values: Vec<Valued<P>>,
            scattered: Vec<Scattered<P>>,
            $($field: Sorted<$members>,)*
        }

        impl<P: Float> Leaves<P> {
            fn new() -> Self {
                Self {
                    of: Box::new(Scattering::zero()),
                    values: Vec::new(),
                    scattered: Vec::new(),
                    $($field: Sorted::new(),)*
                }
            }

            fn clear(&mut self) {
                $(self.$field.clear();)*
            }

            /// Takes number `i` in, if its material is one of these there.
            #[inline(always)]
            fn take(&mut self, i: usize, material: &Material, read: &mut Reading<P>) -> bool {
                match sort(material) {
                    $(Some(Sort::$kind) => self.$field.take(i, material, read),)*
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
            ) -> &mut Vec<Valued<P>> {
                let (of, directions) = (&mut *self.of, (wo, side, wi));
                self.values.clear();
                $(self.$field.eval_pdf(of, directions, &mut self.values);)*
                &mut self.values
            }

            /// As [`Kinds::sample`].
            #[inline(always)]
            fn sample(
                &mut self,
                wo: &Lanes<P>,
                side: &Lane<P>,
                numbers: [&Lane<P>; 3],
            ) -> &mut Vec<Scattered<P>> {
                let (of, from) = (&mut *self.of, (wo, side, numbers));
                self.scattered.clear();
                $(self.$field.sample(of, from, &mut self.scattered);)*
                &mut self.scattered
            }
        }
    };
}

kinds! {
    Diffuse diffuse: Matt<P>,
    Metal metals: Metals<P, P, Ggx>,
    BeckmannMetal beckmann_metals: Metals<P, P, Beckmann>,
    BrushedMetal brushed_metals: Metals<P, Axes<P>, Ggx>,
    BrushedBeckmannMetal brushed_beckmann_metals: Metals<P, Axes<P>, Beckmann>,
    Glass glass: Glass<P>,
    RoughGlass rough_glass: RoughGlass<P, P, Ggx>,
    BeckmannGlass beckmann_glass: RoughGlass<P, P, Beckmann>,
    BrushedGlass brushed_glass: RoughGlass<P, Axes<P>, Ggx>,
    BrushedBeckmannGlass brushed_beckmann_glass: RoughGlass<P, Axes<P>, Beckmann>,
    Plastic plastics: Plastics<P>,
    RoughPlastic rough_plastics: RoughPlastics<P, Ggx>,
    BeckmannPlastic beckmann_plastics: RoughPlastics<P, Beckmann>,
    BlinnPhong phong: Phong<P>,
    Null nothing: Nothing,
    Principled principled: PrincipledSurfaces<P, P>,
    BrushedPrincipled brushed_principled: PrincipledSurfaces<P, Axes<P>>,
    Thin thin: ThinSurfaces<P, P>,
    BrushedThin brushed_thin: ThinSurfaces<P, Axes<P>>,
    Hair hair: Hairs<P>,
}

/// The one of these for the shape of the normals.
#[inline(always)]
fn shaped<T>(roughness: &Roughness<T>, ggx: Sort, beckmann: Sort) -> Option<Sort> {
    roughness.visible.then_some(match roughness.kind {
        Ndf::Ggx => ggx,
        Ndf::Beckmann => beckmann,
    })
}

/// Which of them a material is, if it is one. Where not only visible normals are sampled, it is none.
#[inline(always)]
fn sort(material: &Material) -> Option<Sort> {
    match material {
        Material::Diffuse(_) => Some(Sort::Diffuse),
        Material::RoughConductor(m) => shaped(&m.roughness, Sort::Metal, Sort::BeckmannMetal),
        Material::AnisotropicConductor(m) => {
            shaped(&m.roughness, Sort::BrushedMetal, Sort::BrushedBeckmannMetal)
        }
        Material::Conductor(_) => Some(Sort::Metal),
        Material::Dielectric(_) | Material::ThinDielectric(_) => Some(Sort::Glass),
        Material::RoughDielectric(m) => shaped(&m.roughness, Sort::RoughGlass, Sort::BeckmannGlass),
        Material::AnisotropicDielectric(m) => {
            shaped(&m.roughness, Sort::BrushedGlass, Sort::BrushedBeckmannGlass)
        }
        Material::Plastic(_) => Some(Sort::Plastic),
        Material::RoughPlastic(m) => {
            shaped(&m.roughness, Sort::RoughPlastic, Sort::BeckmannPlastic)
        }
        Material::BlinnPhong(_) => Some(Sort::BlinnPhong),
        Material::Null(_) => Some(Sort::Null),
        Material::Principled(_) => Some(Sort::Principled),
        Material::AnisotropicPrincipled(_) => Some(Sort::BrushedPrincipled),
        Material::PrincipledThin(_) => Some(Sort::Thin),
        Material::AnisotropicThin(_) => Some(Sort::BrushedThin),
        Material::Hair(_) => Some(Sort::Hair),
        _ => None,
    }
}

/// The vertices of a wave, by the kinds of their materials: all but those that are diffuse.
///
/// What it finds is written down: its functions, with all loops of all kinds, are compiled once for a scalar, and not for
/// each estimator that they would call.
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
    pub fn take<'a>(
        &mut self,
        i: usize,
        material: &'a Material,
        read: &mut Reading<'a, P>,
        wo: &dyn Fn() -> Vec3<P>,
    ) -> bool {
        if composites::may_be_one(material) {
            let composites = self.composites.get_or_insert_with(Default::default);
            return composites.take(i, material, read, wo());
        }
        self.leaves.take(i, material, read)
    }

    /// Values and densities of directions to lights.
    #[inline(never)]
    pub fn eval_pdf(&mut self, wo: &Lanes<P>, side: &Lane<P>, wi: &Lanes<P>) -> &[Valued<P>] {
        let values = self.leaves.eval_pdf(wo, side, wi);
        if let Some(composites) = &mut self.composites {
            composites.eval_pdf((wo, side, wi), values);
        }
        values
    }

    /// Scattered directions, made of three lanes of random numbers.
    #[inline(never)]
    pub fn sample(
        &mut self,
        wo: &Lanes<P>,
        side: &Lane<P>,
        numbers: [&Lane<P>; 3],
    ) -> &[Scattered<P>] {
        let scattered = self.leaves.sample(wo, side, numbers);
        if let Some(composites) = &mut self.composites {
            composites.sample((wo, side, numbers), scattered);
        }
        scattered
    }
}
