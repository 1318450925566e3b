//! The parameter vector theta: every number of a scene that could be differentiated, in one flat
//! array with named ranges.
//!
//! Materials and emitters hold [`ParamRef`] handles. What a handle reads depends on the context:
//! with [`Theta`] over `f32` or `f64` it is the value; over a dual number it also carries the tangent
//! of the directions asked for; and in reverse mode the adjoint goes back through the same handle
//! into a [`GradSink`]. A range that is not asked for costs nothing but its value.
//!
//! Models are separable in colour, but for normal maps, heights and tinted base colours: channel c of a result depends on
//! channel c of an RGB parameter only. One tangent slot per RGB parameter therefore holds three derivatives.
//!
//! ```
//! use ad_core::Dual;
//! use render::params::{Tangent, Theta};
//!
//! let mut room = render::scene::room(8, 8)?;
//! let walls = room.params().matching("*.reflectance.value")?; // a pattern, or one name
//! assert_eq!(walls.len(), 4);
//!
//! // All values are one vector. A new one is checked, and what depends on it follows.
//! let mut values = room.params().values().to_vec();
//! let alpha = room.params().find("sphere.alpha")?.clone();
//! values[alpha.offset] = 0.3;
//! room.set_params(&values)?;
//! values[alpha.offset] = -1.0;
//! assert!(room.set_params(&values).is_err());
//! assert_eq!(room.params().get("sphere.alpha.value")?, [0.3]);
//!
//! // Over dual numbers a range has a tangent, or is a constant.
//! type R = Dual<f32, 1>;
//! let handle = room.params().handle(&alpha);
//! let mut tangents = vec![Tangent::None; room.params().infos().len()];
//! tangents[handle.id as usize] = Tangent::Uniform(R::new(0.0, [1.0]));
//! let theta = Theta::<R>::with_tangents(room.params().values(), &tangents);
//! assert_eq!(theta.get(handle, 0), R::new(0.3, [1.0]));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::collections::{HashMap, HashSet};

use ad_core::{Float, Real, array};

use crate::error::RenderError;
use crate::image_io::Encoding;
use crate::math::Rgb;
use crate::prefetch::prefetch;

/// A handle to one named range of theta.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ParamRef {
    /// Index of the range in its [`Params`].
    pub id: u32,
    /// First element in the flat vector.
    pub offset: u32,
}

/// How a range is arranged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParamShape {
    /// One number.
    Scalar,
    /// One linear RGB colour.
    Rgb,
    /// Three components in space: a point, a displacement, a rotation vector.
    Vector,
    /// `[count][3]`: points in space.
    Points {
        /// How many.
        count: usize,
    },
    /// `[height][width][channels]`, row-major.
    Texture {
        /// Number of rows.
        height: usize,
        /// Number of columns.
        width: usize,
        /// 1 or 3.
        channels: usize,
    },
}

impl ParamShape {
    /// Number of values.
    pub fn len(&self) -> usize {
        match *self {
            Self::Scalar => 1,
            Self::Rgb | Self::Vector => 3,
            Self::Points { count } => 3 * count,
            Self::Texture {
                height,
                width,
                channels,
            } => height * width * channels,
        }
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// What a range does to light. Which kinds an estimator sees is in its
/// [`Capabilities`](crate::estimator::Capabilities). A range that does several things is of the last kind that fits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ParamKind {
    /// Reflectance, and whatever else only scales or shapes what is scattered.
    Smooth,
    /// Radiance of emitters, texels of environment maps among it.
    Emission,
    /// Roughness of microsurfaces, exponents of lobes.
    Roughness,
    /// Shading normals of what is not smooth.
    Normals,
    /// A sampled direction is a Dirac delta in it: the index of smooth glass, normals of mirrors. Constant samples have no
    /// derivative in it (F2).
    Delta,
    /// Where a shape is, see [`crate::Scene::movables`].
    Position,
    /// Where the vertices of a mesh face, which stay where they are.
    VertexNormals,
    /// Where the camera is, and what it looks at.
    Camera,
    /// Where lights are, and how environments are turned.
    LightPosition,
}

impl ParamKind {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Smooth,
        Self::Emission,
        Self::Roughness,
        Self::Normals,
        Self::Delta,
        Self::Position,
        Self::VertexNormals,
        Self::Camera,
        Self::LightPosition,
    ];

    /// Whether it moves something: a shape or what is seen of it, the camera or a light.
    pub const fn is_motion(self) -> bool {
        matches!(
            self,
            Self::Position | Self::VertexNormals | Self::Camera | Self::LightPosition
        )
    }

    /// In words, in the plural.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Smooth => "reflectances",
            Self::Emission => "emission",
            Self::Roughness => "roughness",
            Self::Normals => "normals",
            Self::Delta => "Dirac deltas",
            Self::Position => "positions of shapes",
            Self::VertexNormals => "normals at vertices",
            Self::Camera => "cameras",
            Self::LightPosition => "positions of lights",
        }
    }
}

/// One named range.
///
/// ```
/// use render::params::{ParamKind, ParamShape};
///
/// let room = render::scene::room(8, 8)?;
/// let alpha = room.params().find("sphere.alpha")?; // the ending may be left out
/// assert_eq!((alpha.name.as_str(), alpha.shape), ("sphere.alpha.value", ParamShape::Scalar));
/// assert_eq!((alpha.kind, alpha.valid), (ParamKind::Roughness, (1e-4, 1.0)));
/// assert_eq!(room.params().values()[alpha.range()], [0.2]);
///
/// let texels = ParamShape::Texture { height: 4, width: 8, channels: 3 };
/// assert_eq!(texels.len(), 4 * 8 * 3); // [height][width][channels] in the flat vector
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct ParamInfo {
    /// Such as `red.reflectance.value`.
    pub name: String,
    /// First element in the flat vector.
    pub offset: usize,
    /// Arrangement.
    pub shape: ParamShape,
    /// Smallest and largest valid value.
    pub valid: (f64, f64),
    /// What it does to light, which decides on who sees its derivative.
    pub kind: ParamKind,
}

impl ParamInfo {
    /// The elements of this range in the flat vector.
    pub fn range(&self) -> std::ops::Range<usize> {
        self.offset..self.offset + self.shape.len()
    }
}

/// Names, places and values of all parameters of a scene.
///
/// ```
/// use render::params::{ParamKind, ParamShape, Params};
///
/// // Those of a scene are read; `Scene::set` and `Scene::set_params` replace them.
/// let room = render::scene::room(8, 8)?;
/// let params = room.params();
/// let end = params.infos().iter().map(|i| i.range().end).max();
/// assert_eq!(end, Some(params.values().len())); // ranges lie one behind another
/// let walls = params.matching("*.reflectance")?;
/// assert!(walls.iter().all(|w| w.kind == ParamKind::Smooth && w.shape == ParamShape::Rgb));
/// assert_eq!(params.get("left.reflectance")?, &params.values()[params.find("left.reflectance")?.range()]);
///
/// // A material of one's own can be tried without a scene.
/// let mut own = Params::default();
/// own.push("felt.reflectance.value", ParamShape::Rgb, &[0.5, 0.6, 0.7], (0.0, 1.0));
/// let second = own.push("felt.reflectance.value", ParamShape::Scalar, &[0.5], (0.0, 1.0));
/// assert_eq!((own.infos()[1].name.as_str(), second.offset), ("felt.reflectance.value_1", 3));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Params {
    infos: Vec<ParamInfo>,
    by_name: HashMap<String, u32>,
    /// The last suffix that made a name unique.
    suffixes: HashMap<String, u32>,
    values: Vec<f32>,
    /// Other beginnings of names, and those that they stand for.
    aliases: HashMap<String, String>,
    /// The first other beginning of a name.
    others: HashMap<String, String>,
    /// Other beginnings that would stand for several.
    of_several: HashSet<String>,
    /// How the images that texels were read from are encoded.
    encodings: HashMap<u32, Encoding>,
}

/// What names of values may end in, or not.
const ENDINGS: [&str; 2] = [".value", ".data"];
/// So often beginnings of a name stand for others at most.
const MOST_ALIASES: usize = 16;
/// And so often where a pattern asks for all that stand for one.
const MOST_ALIASES_OF_ONE: usize = 4;

impl Params {
    /// Adds a range, [`ParamKind::Smooth`] until a scene is built of materials and emitters that say otherwise. The name
    /// is made unique by a suffix `_1`, `_2`, .. when it is taken.
    pub fn push(
        &mut self,
        name: &str,
        shape: ParamShape,
        values: &[f32],
        valid: (f64, f64),
    ) -> ParamRef {
        debug_assert_eq!(shape.len(), values.len());
        let mut unique = name.to_owned();
        if self.by_name.contains_key(name) {
            // All suffixes up to the last one are taken.
            let last = self.suffixes.entry(name.to_owned()).or_default();
            while self.by_name.contains_key(&unique) {
                *last += 1;
                unique = format!("{name}_{last}");
            }
        }
        let id = self.infos.len() as u32;
        let offset = self.values.len();
        self.by_name.insert(unique.clone(), id);
        self.infos.push(ParamInfo {
            name: unique,
            offset,
            shape,
            valid,
            kind: ParamKind::Smooth,
        });
        self.values.extend_from_slice(values);
        ParamRef {
            id,
            offset: offset as u32,
        }
    }

    /// Says that a range is also called `name`, where that is free.
    pub(crate) fn also_call(&mut self, p: ParamRef, name: String) {
        self.by_name.entry(name).or_insert(p.id);
    }

    /// Says how the image of a range is encoded.
    pub(crate) fn encode(&mut self, p: ParamRef, encoding: Encoding) {
        self.encodings.insert(p.id, encoding);
    }

    /// How an image that replaces the texels of a range is to be read: as the one in the scene was; without one, colours
    /// as sRGB and numbers as they are.
    pub fn encoding(&self, info: &ParamInfo) -> Encoding {
        let given = self.by_name.get(&info.name);
        let given = given.and_then(|id| self.encodings.get(id));
        given.copied().unwrap_or(match info.shape {
            ParamShape::Texture { channels: 3, .. } if info.kind != ParamKind::Normals => {
                Encoding::Srgb
            }
            _ => Encoding::Raw,
        })
    }

    /// Sets the interval in which the values of a range are valid.
    pub(crate) fn bound(&mut self, p: ParamRef, valid: (f64, f64)) {
        self.infos[p.id as usize].valid = valid;
    }

    /// Says that this range is of a kind, unless it is of a later one already.
    pub(crate) fn mark(&mut self, p: ParamRef, kind: ParamKind) {
        let own = &mut self.infos[p.id as usize].kind;
        *own = kind.max(*own);
    }

    /// All ranges, in the order of the flat vector.
    pub fn infos(&self) -> &[ParamInfo] {
        &self.infos
    }

    /// The flat vector.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// The flat vector, to be changed. Scenes keep tables that depend on it: go through
    /// [`crate::Scene::set_params`].
    pub(crate) fn values_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }

    /// Says that names that begin with `own` may begin with `other` as well; the first who says so of `other` is right.
    pub(crate) fn alias(&mut self, other: String, own: &str) {
        if other == own {
            return;
        }
        (self.others.entry(own.to_owned())).or_insert_with(|| other.clone());
        self.aliases.entry(other).or_insert_with(|| own.to_owned());
    }

    /// Says that names that begin with `other` stand for those that begin with `own`, as [`Params::alias`] does, where lists
    /// show another one; the first who says so is right.
    pub(crate) fn answer(&mut self, other: String, own: &str) {
        if other != own {
            self.aliases.entry(other).or_insert_with(|| own.to_owned());
        }
    }

    /// The same of what can have one own name only: it has no other one where several say so.
    pub(crate) fn answer_of_one(&mut self, other: &str, own: &str) {
        if self.of_several.contains(other) {
            return;
        }
        match self.aliases.get(other) {
            Some(known) if known != own => {
                self.aliases.remove(other);
                self.of_several.insert(other.to_owned());
            }
            _ => self.answer(other.to_owned(), own),
        }
    }

    /// What a name of a thing stands for, if it is another one.
    pub(crate) fn stands_for<'a>(&'a self, other: &'a str) -> &'a str {
        self.aliases.get(other).map_or(other, String::as_str)
    }

    /// The range called `name`: by its own name or by the way to it, as Mitsuba has it (`floor.bsdf.brdf_0.alpha.value`
    /// for an `alpha` in a material of a material of the shape `floor`, whatever ids they have), with or without the
    /// `.value` or `.data` at the end.
    ///
    /// # Errors
    /// [`RenderError::UnknownParameter`], with the closest known names.
    pub fn find(&self, name: &str) -> Result<&ParamInfo, RenderError> {
        let own = |name: &str| self.by_name.get(name).map(|&id| &self.infos[id as usize]);
        let ended = |name: &str| {
            own(name).or_else(|| {
                let longer = ENDINGS.iter().find_map(|end| own(&format!("{name}{end}")));
                let shorter = || ENDINGS.iter().find_map(|end| own(name.strip_suffix(end)?));
                longer.or_else(shorter)
            })
        };
        let mut wanted = name.to_owned();
        for _ in 0..MOST_ALIASES {
            if let Some(info) = ended(&wanted) {
                return Ok(info);
            }
            match replaced(&wanted, &self.aliases) {
                Some(next) => wanted = next,
                None => break,
            }
        }
        let names = self.infos.iter().map(|i| &i.name);
        Err(RenderError::unknown_parameter(name, names))
    }

    /// Whether a key is a pattern ([`Params::matching`]).
    pub fn is_pattern(key: &str) -> bool {
        key.contains(['*', '?'])
    }

    /// All ranges of which any name fits a pattern, be it their own, or one that [`Params::find`] takes for theirs: `*` stands for
    /// any text, `?` for any character. The pattern may leave out the `.value` or `.data` at the end. One without stars and
    /// question marks is a name, as there.
    ///
    /// # Errors
    /// [`RenderError::UnknownParameter`] where nothing does.
    pub fn matching(&self, pattern: &str) -> Result<Vec<&ParamInfo>, RenderError> {
        if !Self::is_pattern(pattern) {
            return self.find(pattern).map(|info| vec![info]);
        }
        let mut ways: HashMap<&str, Vec<&str>> = HashMap::new();
        for (other, own) in &self.aliases {
            ways.entry(own).or_default().push(other);
        }
        let fits = |info: &&ParamInfo| fits_any(pattern, &info.name, &ways, MOST_ALIASES_OF_ONE);
        let found: Vec<_> = self.infos.iter().filter(fits).collect();
        if found.is_empty() {
            let names = self.infos.iter().map(|i| &i.name);
            return Err(RenderError::unknown_parameter(pattern, names));
        }
        Ok(found)
    }

    /// The way to a range from the scene, as Mitsuba has it, if that is not its name.
    pub fn other_name(&self, info: &ParamInfo) -> Option<String> {
        let mut name = info.name.clone();
        for _ in 0..MOST_ALIASES {
            match replaced(&name, &self.others) {
                Some(next) => name = next,
                None => break,
            }
        }
        (name != info.name).then_some(name)
    }

    /// The values of the range called `name`; [`Scene::set`](crate::Scene::set) replaces them.
    ///
    /// # Errors
    /// As [`Params::find`].
    pub fn get(&self, name: &str) -> Result<&[f32], RenderError> {
        self.find(name).map(|info| &self.values[info.range()])
    }

    /// How large a range's values are: their root mean square; one where all are zero.
    pub fn size(&self, info: &ParamInfo) -> f64 {
        let values = &self.values()[info.range()];
        let squares: f64 = values.iter().map(|&v| f64::from(v).powi(2)).sum();
        if squares > 0.0 {
            (squares / values.len() as f64).sqrt()
        } else {
            1.0
        }
    }

    /// The handle of a range.
    pub fn handle(&self, info: &ParamInfo) -> ParamRef {
        ParamRef {
            id: self.by_name[&info.name],
            offset: info.offset as u32,
        }
    }
}

/// Whether a name, or what stands for it where beginnings have other names, fits a pattern, with or without the ending.
fn fits_any(pattern: &str, name: &str, ways: &HashMap<&str, Vec<&str>>, most: usize) -> bool {
    let bare = ENDINGS.iter().find_map(|end| name.strip_suffix(end));
    if fits(pattern, name) || bare.is_some_and(|bare| fits(pattern, bare)) {
        return true;
    }
    let Some(most) = most.checked_sub(1) else {
        return false;
    };
    name.match_indices('.').any(|(end, _)| {
        let others = ways.get(&name[..end]).into_iter().flatten();
        let mut others = others.map(|other| format!("{other}{}", &name[end..]));
        others.any(|other| fits_any(pattern, &other, ways, most))
    })
}

/// A name whose longest known beginning is replaced, which may be all of it.
fn replaced(name: &str, by: &HashMap<String, String>) -> Option<String> {
    if let Some(all) = by.get(name) {
        return Some(all.clone());
    }
    let mut ends = name.rmatch_indices('.').map(|(i, _)| i);
    ends.find_map(|end| Some(format!("{}{}", by.get(&name[..end])?, &name[end..])))
}

/// Whether a text fits a pattern with `*` and `?`.
pub(crate) fn fits(pattern: &str, text: &str) -> bool {
    let (pattern, text): (Vec<char>, Vec<char>) =
        (pattern.chars().collect(), text.chars().collect());
    let (mut p, mut t) = (0, 0);
    // Where the last star stands, and what it has taken so far.
    let mut star: Option<(usize, usize)> = None;
    while t < text.len() {
        if p < pattern.len() && pattern[p] == '*' {
            star = Some((p, t));
            p += 1;
        } else if p < pattern.len() && (pattern[p] == '?' || pattern[p] == text[t]) {
            (p, t) = (p + 1, t + 1);
        } else if let Some((at, taken)) = star {
            star = Some((at, taken + 1));
            (p, t) = (at + 1, taken + 1);
        } else {
            return false;
        }
    }
    pattern[p..].iter().all(|c| *c == '*')
}

/// The tangent of one range in forward mode: numbers whose primal part is zero.
#[derive(Clone, Debug)]
pub enum Tangent<R> {
    /// The range does not move.
    None,
    /// The same tangent for every element ("one number added to all texels").
    Uniform(R),
    /// One per element.
    Dense(Vec<R>),
}

/// The tangent of a few elements, for derivatives at one vertex.
#[derive(Clone, Copy, Debug)]
pub struct Seed<R> {
    /// Index of the range.
    pub param: u32,
    /// What of the range moves.
    pub which: Which,
    /// Its tangent: a number whose primal part is zero.
    pub tangent: R,
}

/// Elements of a range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Which {
    /// All of them.
    All,
    /// One of three channels of all texels.
    Channel(u32),
    /// One element.
    One(u32),
}

impl Which {
    #[inline(always)]
    fn has(self, i: usize) -> bool {
        match self {
            Self::All => true,
            Self::Channel(c) => i % 3 == c as usize,
            Self::One(element) => i == element as usize,
        }
    }
}

/// Which parameters move, and how.
#[derive(Debug)]
enum Tangents<'a, R> {
    /// One entry per range; missing ones do not move.
    Ranges(&'a [Tangent<R>]),
    /// Only these.
    Seeds(&'a [Seed<R>]),
}

impl<R> Clone for Tangents<'_, R> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<R> Copy for Tangents<'_, R> {}

/// Theta as seen by code over the scalar `R`.
///
/// ```
/// use ad_core::{Dual, Real};
/// use render::params::{ParamShape, Params, Tangent, Theta};
///
/// let mut params = Params::default();
/// let a = params.push("a", ParamShape::Scalar, &[3.0], (0.0, 9.0));
/// let b = params.push("b", ParamShape::Scalar, &[2.0], (0.0, 9.0));
/// fn model<R: Real>(a: R, b: R) -> R {
///     a * a * b
/// }
/// let plain = Theta::<f32>::constant(params.values());
/// assert_eq!(model(plain.get(a, 0), plain.get(b, 0)), 18.0);
///
/// // One tangent per range: `a` moves by one and `b` not at all.
/// type R = Dual<f32, 1>;
/// let tangents = [Tangent::Uniform(R::new(0.0, [1.0])), Tangent::None];
/// let moving = Theta::<R>::with_tangents(params.values(), &tangents);
/// assert!(moving.moves(a) && !moving.moves(b));
/// assert_eq!(model(moving.get(a, 0), moving.get(b, 0)), R::new(18.0, [2.0 * 3.0 * 2.0]));
/// ```
#[derive(Debug)]
pub struct Theta<'a, R: Real> {
    values: &'a [R::Primal],
    tangents: Tangents<'a, R>,
}

impl<R: Real> Clone for Theta<'_, R> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<R: Real> Copy for Theta<'_, R> {}

impl<'a, R: Real> Theta<'a, R> {
    /// Without tangents.
    pub fn constant(values: &'a [R::Primal]) -> Self {
        Self {
            values,
            tangents: Tangents::Ranges(&[]),
        }
    }

    /// No parameters at all: for shapes as the scene has them, of which nothing moves.
    #[inline(always)]
    pub fn still() -> Self {
        Self::constant(&[])
    }

    /// The values of `theta`, of which the `seeds` move.
    pub fn seeded(theta: &Theta<'a, R::Primal>, seeds: &'a [Seed<R>]) -> Self {
        Self {
            values: theta.values,
            tangents: Tangents::Seeds(seeds),
        }
    }

    /// Values with one [`Tangent`] per range of the layout.
    pub fn with_tangents(values: &'a [R::Primal], tangents: &'a [Tangent<R>]) -> Self {
        Self {
            values,
            tangents: Tangents::Ranges(tangents),
        }
    }

    /// The values of all parameters; none for [`Theta::still`].
    pub fn values(&self) -> &'a [R::Primal] {
        self.values
    }

    /// The same parameters without tangents.
    #[inline]
    pub fn primal(&self) -> Theta<'a, R::Primal> {
        Theta {
            values: self.values,
            tangents: Tangents::Ranges(&[]),
        }
    }

    /// Whether the range moves.
    #[inline]
    pub fn moves(&self, p: ParamRef) -> bool {
        !R::IS_PRIMAL
            && match self.tangents {
                Tangents::Ranges(t) => !matches!(t.get(p.id as usize), None | Some(Tangent::None)),
                Tangents::Seeds(s) => s.iter().any(|s| s.param == p.id),
            }
    }

    /// Element `i` of a range.
    #[inline(always)]
    pub fn get(&self, p: ParamRef, i: usize) -> R {
        let value = R::lift(self.values[p.offset as usize + i]);
        if R::IS_PRIMAL {
            return value;
        }
        match self.tangents {
            Tangents::Ranges(tangents) => match tangents.get(p.id as usize) {
                None | Some(Tangent::None) => value,
                Some(Tangent::Uniform(t)) => value + *t,
                Some(Tangent::Dense(t)) => value + t[i],
            },
            Tangents::Seeds(seeds) => seeds
                .iter()
                .filter(|s| s.param == p.id && s.which.has(i))
                .fold(value, |sum, s| sum + s.tangent),
        }
    }

    /// Texel `i` of a range with `C` channels.
    #[inline(always)]
    pub fn texel<const C: usize>(&self, p: ParamRef, i: usize) -> [R; C] {
        if !self.moves(p) {
            // One check of the range for all channels.
            let values = &self.values[p.offset as usize + i * C..][..C];
            return array(|c| R::lift(values[c]));
        }
        array(|c| self.get(p, i * C + c))
    }
}

impl<'a, P: Float> Theta<'a, P> {
    /// Says that element `i` of the range will soon be read: many at a time need not wait one by one.
    #[inline(always)]
    pub(crate) fn expect(&self, p: ParamRef, i: usize) {
        self.values
            .get(p.offset as usize + i)
            .into_iter()
            .for_each(prefetch);
    }

    /// The same parameters over a scalar with tangents, all of them zero.
    #[inline]
    pub fn lift<R: Real<Primal = P>>(&self) -> Theta<'a, R> {
        Theta::constant(self.values)
    }
}

/// Where adjoints of parameters go.
///
/// A material of one's own can be asked for the adjoints of its parameters by a sink of a few lines: see the example of
/// [`crate::bsdf`].
pub trait GradSink<P: Float> {
    /// Whether derivatives in this range are wanted.
    fn active(&self, p: ParamRef) -> bool;
    /// Adds `d`, the adjoint of element `i` of the range.
    fn add(&mut self, p: ParamRef, i: usize, d: P);
    /// The same for `C` elements from the `i`-th on.
    #[inline]
    fn add_all<const C: usize>(&mut self, p: ParamRef, i: usize, d: [P; C]) {
        for (c, d) in d.into_iter().enumerate() {
            self.add(p, i + c, d);
        }
    }
    /// Says that something will soon be added to element `i`: many at a time need not wait for their memory one by
    /// one.
    #[inline]
    fn expect(&mut self, _p: ParamRef, _i: usize) {}
}

/// Adjoint of an RGB value as one number per channel, or of a scalar as their sum.
#[inline]
pub fn per_channel<const C: usize, P: Float>(d: Rgb<P>) -> [P; C] {
    if C == 1 {
        [d.sum(); C]
    } else {
        array(|c| d[c])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_fit_texts() {
        for (pattern, text, expected) in [
            ("*", "", true),
            ("*.alpha.value", "a.b.alpha.value", true),
            ("*.alpha.*", "a.alpha.value", true),
            ("a?c", "abc", true),
            ("a?c", "ac", false),
            ("*b*b*", "abab", true),
            ("*b*b*", "ab", false),
            ("a*", "ba", false),
        ] {
            assert_eq!(fits(pattern, text), expected, "{pattern} {text}");
        }
    }

    #[test]
    fn ranges_answer_to_several_names() {
        let mut params = Params::default();
        let mut push = |name: &str| params.push(name, ParamShape::Scalar, &[0.5], (0.0, 1.0));
        push("wood.reflectance.value");
        push("inner.alpha.value");
        push("glass.eta.value");
        push("env.data");
        for (other, own) in [
            ("floor.bsdf", "wood"),
            ("wall.bsdf", "wood"),
            ("wood.brdf_0", "inner"),
            ("EnvironmentMapEmitter", "env"),
        ] {
            params.alias(other.to_owned(), own);
        }
        for (name, own) in [
            ("wood.reflectance.value", "wood.reflectance.value"),
            ("wood.reflectance", "wood.reflectance.value"),
            ("wall.bsdf.reflectance.value", "wood.reflectance.value"),
            ("floor.bsdf.brdf_0.alpha", "inner.alpha.value"),
            ("glass.eta", "glass.eta.value"),
            ("EnvironmentMapEmitter.data", "env.data"),
            ("env.data.value", "env.data"),
        ] {
            assert_eq!(params.find(name).expect(name).name, own);
        }
        let other = |name| params.other_name(params.find(name).expect("a name"));
        assert_eq!(
            other("inner.alpha.value").expect("one"),
            "floor.bsdf.brdf_0.alpha.value"
        );
        assert_eq!(
            other("wood.reflectance.value").expect("one"),
            "floor.bsdf.reflectance.value"
        );
        assert_eq!(other("glass.eta.value"), None);
        let names = |pattern| -> Vec<String> {
            let found = params.matching(pattern).expect(pattern);
            found.iter().map(|i| i.name.clone()).collect()
        };
        assert_eq!(names("*.value").len(), 3);
        assert_eq!(
            names("floor.*"),
            ["wood.reflectance.value", "inner.alpha.value"]
        );
        assert_eq!(names("glass.eta"), ["glass.eta.value"]);
        let error = params
            .matching("*.roughness")
            .expect_err("nothing")
            .to_string();
        assert!(
            error.contains("`*.roughness`") && error.contains("closest"),
            "{error}"
        );
        let error = params
            .find("wood.reflectence.value")
            .expect_err("nothing")
            .to_string();
        assert!(error.contains("closest: wood.reflectance.value"), "{error}");
    }
}
