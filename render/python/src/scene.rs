//! Scenes: parameters, images, gradients.

use std::collections::{HashMap, HashSet};
use std::ffi::CString;
use std::ops::{Deref, DerefMut};
use std::path::PathBuf;
use std::sync::{RwLock, RwLockReadGuard, RwLockWriteGuard, TryLockError};

use numpy::{PyArray3, PyArrayDyn};
use pyo3::PyTypeInfo;
use pyo3::exceptions::{
    PyKeyError, PyRuntimeError, PyRuntimeWarning, PyTypeError, PyUserWarning, PyValueError,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyMapping, PyString};
use render::auto::{self, Mixture};
use render::check::{Options, check, most_passes};
use render::instances::{Direction, Estimator, Mode, render_f32, render_f64};
use render::integrator::coverage::coverage;
use render::integrator::render::{NonFinite, Progress};
use render::params::{ParamInfo, Params, Theta};
use render::sampler::Points;
use render::scene::{LightChoice, LoadOptions};
use render::{Job, Settings};

use crate::arrays::{self, Like, array, image, like, pixels, range, shape};
use crate::check::Check;
use crate::error::Error;
use crate::estimators::or_auto;
use crate::work::{apart, work};

/// A scene: what is in it, how it is rendered, and all its parameters by name.
///
/// `scene[key]` is a copy of a parameter as an array, and `scene[key] = value` replaces it, by an array of the same shape
/// or by one number for all of it; `*` and `?` in that key stand for any text and any character, and all that fits is
/// replaced. Keys are those of Mitsuba; matrices of shapes and of the sensor (`scene["ball.to_world"]`) are
/// arrays of 4 x 4, and may turn, move and scale evenly what was loaded.
#[pyclass(frozen, mapping, module = "render_gradients")]
pub struct Scene {
    inner: RwLock<render::Scene>,
    warnings: Vec<String>,
}

/// Loads a Mitsuba scene file. `defines` are values for its `$names`; `allow_missing` substitutes mid-grey for missing
/// textures; `sensor` is the one to look through, by its id or its number, instead of the first. What is ignored or substituted
/// is warned of.
#[pyfunction]
#[pyo3(signature = (path, *, defines = None, allow_missing = false, sensor = None))]
pub fn load(
    py: Python<'_>,
    path: PathBuf,
    defines: Option<HashMap<String, Bound<'_, PyAny>>>,
    allow_missing: bool,
    sensor: Option<Bound<'_, PyAny>>,
) -> PyResult<Scene> {
    let options = options(defines, allow_missing, sensor)?;
    let read = apart(py, move || Ok(render::Scene::load(&path, &options)?))?;
    loaded(py, read)
}

/// Loads a scene from the text of a Mitsuba scene file. File names in it are relative to `base`.
#[pyfunction]
#[pyo3(signature = (text, *, base = None, defines = None, allow_missing = false, sensor = None))]
pub fn load_string(
    py: Python<'_>,
    text: &str,
    base: Option<PathBuf>,
    defines: Option<HashMap<String, Bound<'_, PyAny>>>,
    allow_missing: bool,
    sensor: Option<Bound<'_, PyAny>>,
) -> PyResult<Scene> {
    let options = options(defines, allow_missing, sensor)?;
    let (text, base) = (text.to_owned(), base.unwrap_or_default());
    let read = apart(py, move || {
        Ok(render::Scene::from_xml(&text, &base, &options)?)
    })?;
    loaded(py, read)
}

/// A scene from a file, after a warning of each of its warnings: few look at those without being told.
fn loaded(py: Python<'_>, read: (render::Scene, Vec<String>)) -> PyResult<Scene> {
    let scene = Scene::made(read)?;
    for message in &scene.warnings {
        warn::<PyUserWarning>(py, message)?;
    }
    Ok(scene)
}

/// A room to begin with, without any file: coloured walls on the left and right (`left.reflectance.value`,
/// `right.reflectance.value`), a lamp in the ceiling (`light.emitter.radiance.value`), a matt block, and a sphere of rough
/// metal (`sphere.alpha.value`).
#[pyfunction]
#[pyo3(signature = (width = 128, height = 128))]
pub fn room(
    py: Python<'_>,
    #[pyo3(from_py_with = pixels_across)] width: u32,
    #[pyo3(from_py_with = pixels_across)] height: u32,
) -> PyResult<Scene> {
    let made = work(py, 1, None, |_| Ok(render::scene::room(width, height)?))?;
    Scene::made((made, Vec::new()))
}

/// The name or the number of a sensor.
fn sensor_name(sensor: &Bound<'_, PyAny>) -> PyResult<String> {
    if let Ok(name) = sensor.cast::<PyString>() {
        return Ok(name.to_string());
    }
    let number: u64 = integer("sensor", [0, u64::MAX], ", or an id", sensor)?;
    Ok(number.to_string())
}

fn options(
    defines: Option<HashMap<String, Bound<'_, PyAny>>>,
    allow_missing: bool,
    sensor: Option<Bound<'_, PyAny>>,
) -> PyResult<LoadOptions> {
    let text = |(name, value): (String, Bound<'_, PyAny>)| Ok((name, value.str()?.to_string()));
    let mut defines = (defines.into_iter().flatten())
        .map(text)
        .collect::<PyResult<Vec<_>>>()?;
    // Whose error comes first does not depend on how names are hashed.
    defines.sort();
    Ok(LoadOptions {
        defines,
        allow_missing,
        sensor: sensor.map(|s| sensor_name(&s)).transpose()?,
        // All that makes images or gradients can name another.
        several_sensors: true,
    })
}

/// A name, or a sequence of names, each once.
///
/// # Errors
/// Anything else; no names at all.
pub fn several(keys: &Bound<'_, PyAny>) -> PyResult<Vec<String>> {
    let given: Vec<String> = match keys.cast::<PyString>() {
        Ok(one) => vec![one.to_string()],
        Err(_) => (keys.try_iter()?.map(|k| k?.extract())).collect::<PyResult<_>>()?,
    };
    if given.is_empty() {
        return Err(PyValueError::new_err(
            "keys: expected at least one parameter, found none",
        ));
    }
    let mut seen = HashSet::new();
    Ok((given.into_iter())
        .filter(|k| seen.insert(k.clone()))
        .collect())
}

/// The name of a value in a list of names.
fn name_of<T: PartialEq>(names: &[(&'static str, T)], value: &T) -> &'static str {
    names
        .iter()
        .find(|(_, v)| v == value)
        .map_or("", |(name, _)| name)
}

/// The value of a name in a list of names.
fn named<T: Copy>(what: &str, names: &[(&'static str, T)], name: &str) -> PyResult<T> {
    let found = names.iter().find(|(n, _)| *n == name);
    found.map(|(_, value)| *value).ok_or_else(|| {
        let known: Vec<&str> = names.iter().map(|(n, _)| *n).collect();
        let known = known.join(", ");
        PyValueError::new_err(format!("{what}: expected one of {known}, found `{name}`"))
    })
}

/// Most samples per pixel.
const MOST_SAMPLES: u64 = 1 << 30;

/// An integer within bounds, named and shown where it is not: conversions by themselves say neither.
fn integer<T: TryFrom<u64>>(
    name: &str,
    bounds: [u64; 2],
    of: &str,
    value: &Bound<'_, PyAny>,
) -> PyResult<T> {
    let found = match value.extract::<u64>() {
        Err(e) if e.is_instance_of::<PyTypeError>(value.py()) => return Err(e),
        found => found.ok().filter(|n| (bounds[0]..=bounds[1]).contains(n)),
    };
    found.and_then(|n| T::try_from(n).ok()).ok_or_else(|| {
        let [low, high] = bounds;
        PyValueError::new_err(format!(
            "{name}: expected {low} to {high}{of}, found {value}"
        ))
    })
}

fn sample_count(spp: &Bound<'_, PyAny>) -> PyResult<u32> {
    integer("spp", [1, MOST_SAMPLES], " samples per pixel", spp)
}

/// The samples per pixel that were asked for, if any were.
fn some_samples(spp: &Bound<'_, PyAny>) -> PyResult<Option<u32>> {
    (!spp.is_none()).then(|| sample_count(spp)).transpose()
}

fn pixels_across(pixels: &Bound<'_, PyAny>) -> PyResult<u32> {
    integer("width and height", [0, u32::MAX.into()], " pixels", pixels)
}

fn seed_from(seed: &Bound<'_, PyAny>) -> PyResult<u64> {
    integer("seed", [0, u64::MAX], "", seed)
}

fn repeats_from(repeats: &Bound<'_, PyAny>) -> PyResult<u32> {
    integer("repeats", [0, u32::MAX.into()], "", repeats)
}

/// A warning of this kind.
fn warn<Category: PyTypeInfo>(py: Python<'_>, message: &str) -> PyResult<()> {
    let category = py.get_type::<Category>();
    PyErr::warn(py, category.as_any(), &CString::new(message)?, 1)
}

/// Warns of samples that were left out.
fn warn_of(py: Python<'_>, bad: &NonFinite, width: usize, seed: u64) -> PyResult<()> {
    let Some((pixel, sample)) = bad.first else {
        return Ok(());
    };
    let (x, y) = (pixel % width as u64, pixel / width as u64);
    let message = format!(
        "{} samples were not finite and are left out; the first is sample {sample} of pixel ({x}, {y}) with seed {seed}",
        bad.count
    );
    warn::<PyRuntimeWarning>(py, &message)
}

/// Warns of shapes of which samples of edges do not tell how they cross.
fn warn_of_doubts<N: AsRef<str>>(
    py: Python<'_>,
    scene: &render::Scene,
    estimator: Estimator,
    keys: &[N],
) -> PyResult<()> {
    let mut doubts = estimator.doubts(scene, keys).into_iter();
    doubts.try_for_each(|doubt| warn::<PyRuntimeWarning>(py, &doubt))
}

impl Scene {
    /// Its samples are spread as tools spread them.
    fn made((mut inner, warnings): (render::Scene, Vec<String>)) -> PyResult<Self> {
        inner.settings.points = Points::Sobol;
        Ok(Self {
            inner: RwLock::new(inner),
            warnings,
        })
    }

    /// The scene, to be looked at.
    ///
    /// # Errors
    /// Somebody is changing it.
    pub fn read(&self) -> PyResult<RwLockReadGuard<'_, render::Scene>> {
        match self.inner.try_read() {
            Ok(scene) => Ok(scene),
            Err(TryLockError::Poisoned(scene)) => Ok(scene.into_inner()),
            Err(TryLockError::WouldBlock) => Err(PyRuntimeError::new_err(
                "the scene is being checked or changed by another thread",
            )),
        }
    }

    /// The scene, to be changed.
    ///
    /// # Errors
    /// Somebody is working with it.
    pub fn write(&self) -> PyResult<RwLockWriteGuard<'_, render::Scene>> {
        match self.inner.try_write() {
            Ok(scene) => Ok(scene),
            Err(TryLockError::Poisoned(scene)) => Ok(scene.into_inner()),
            Err(TryLockError::WouldBlock) => Err(PyRuntimeError::new_err(
                "the scene is being rendered, and cannot be changed meanwhile",
            )),
        }
    }
}

/// Whether a key is that of a matrix.
fn is_matrix(key: &str) -> bool {
    render::Scene::is_matrix(key)
}

/// A scene that nobody else looks at, through one of its sensors; through its own again afterwards.
pub struct Alone<'a> {
    scene: RwLockWriteGuard<'a, render::Scene>,
    /// The own sensor and its settings, where it is another.
    own: Option<(usize, Settings)>,
}

impl Deref for Alone<'_> {
    type Target = render::Scene;
    fn deref(&self) -> &render::Scene {
        &self.scene
    }
}

impl DerefMut for Alone<'_> {
    fn deref_mut(&mut self) -> &mut render::Scene {
        &mut self.scene
    }
}

impl Drop for Alone<'_> {
    fn drop(&mut self) {
        if let Some((own, settings)) = self.own {
            // It did look through that before.
            if self.scene.look_through(own).is_ok() {
                self.scene.settings = settings;
            }
        }
    }
}

/// A scene as one of its sensors sees it: others may look as well where that is its own.
pub enum Seen<'a> {
    Shared(RwLockReadGuard<'a, render::Scene>),
    Alone(Box<Alone<'a>>),
}

impl Deref for Seen<'_> {
    type Target = render::Scene;
    fn deref(&self) -> &render::Scene {
        match self {
            Self::Shared(scene) => scene,
            Self::Alone(scene) => scene,
        }
    }
}

impl Scene {
    /// The scene through a sensor; its own, if none is named.
    ///
    /// # Errors
    /// There is no such sensor, or somebody is working with the scene.
    fn through(&self, sensor: Option<&Bound<'_, PyAny>>) -> PyResult<Seen<'_>> {
        let scene = self.read()?;
        match number_of(&scene, sensor)? {
            Some(number) if number != scene.sensor_number() => {
                drop(scene);
                Ok(Seen::Alone(Box::new(self.alone(sensor)?)))
            }
            _ => Ok(Seen::Shared(scene)),
        }
    }

    /// The same, to be changed meanwhile.
    fn alone(&self, sensor: Option<&Bound<'_, PyAny>>) -> PyResult<Alone<'_>> {
        let mut scene = self.write()?;
        let number = number_of(&scene, sensor)?;
        let own = (scene.sensor_number(), scene.settings);
        let other = number.filter(|number| *number != own.0);
        if let Some(number) = other {
            scene.look_through(number).map_err(Error::from)?;
        }
        Ok(Alone {
            scene,
            own: other.map(|_| own),
        })
    }
}

/// The number of a sensor, if one is named.
fn number_of(scene: &render::Scene, sensor: Option<&Bound<'_, PyAny>>) -> PyResult<Option<usize>> {
    let number = |sensor| {
        let name = sensor_name(sensor)?;
        PyResult::Ok(scene.sensor_called(&name).map_err(Error::from)?)
    };
    sensor.map(number).transpose()
}

/// The names of all parameters that fit these, which may be patterns, each once.
///
/// # Errors
/// One that nothing fits.
pub fn all_named(scene: &render::Scene, keys: &[String]) -> PyResult<Vec<String>> {
    let mut names: Vec<String> = Vec::new();
    for key in keys {
        scene.refuse_matrix(key).map_err(Error::from)?;
        for info in scene.params().matching(key).map_err(Error::from)? {
            if !names.contains(&info.name) {
                names.push(info.name.clone());
            }
        }
    }
    Ok(names)
}

/// How many names an error has at most.
const MOST_NAMES: usize = 8;

/// The parameter of this name.
///
/// # Errors
/// An unknown name; a pattern, with what fits it.
fn one<'a>(scene: &'a render::Scene, key: &str) -> PyResult<&'a ParamInfo> {
    let params = scene.params();
    if !Params::is_pattern(key) {
        return Ok(params.find(key).map_err(Error::from)?);
    }
    let fitting = params.matching(key).map_err(Error::from)?;
    let names: Vec<&str> = fitting.iter().map(|info| info.name.as_str()).collect();
    let (some, more) = names.split_at(names.len().min(MOST_NAMES));
    let more = match more.len() {
        0 => String::new(),
        n => format!(" and {n} more"),
    };
    Err(PyKeyError::new_err(format!(
        "expected the name of one parameter, found the pattern `{key}` of {}{more}",
        some.join(", ")
    )))
}

/// Its settings with so many samples per pixel.
fn settings(scene: &render::Scene, spp: Option<u32>) -> Settings {
    Settings {
        spp: spp.unwrap_or(scene.settings.spp),
        ..scene.settings
    }
}

fn size(scene: &render::Scene) -> [usize; 2] {
    scene.film.crop_size.map(|n| n as usize)
}

/// One estimator for the named parameters, or what pilots choose for `budget` samples per pixel to come.
fn mixture(
    scene: &render::Scene,
    keys: &[String],
    adjoint: &[f32],
    estimator: Option<Estimator>,
    job: &Job,
    mode: Mode,
) -> Result<Mixture, Error> {
    match estimator {
        Some(e) => {
            e.check(scene)?;
            e.active(scene, keys)?;
            Ok(Mixture::only(scene, e, keys))
        }
        None => Ok(auto::choose(
            job,
            keys,
            adjoint,
            &auto::candidates(scene),
            mode,
        )?),
    }
}

/// All parameters that an estimator sees; `auto` sees what `mis` does.
fn seen(scene: &render::Scene, estimator: Option<Estimator>) -> Vec<String> {
    let can = estimator.unwrap_or(Estimator::Mis).capabilities();
    let infos = scene.params().infos().iter();
    infos
        .filter(|i| can.sees(i.kind))
        .map(|i| i.name.clone())
        .collect()
}

#[pymethods]
impl Scene {
    /// The names of all parameters.
    fn keys(&self) -> PyResult<Vec<String>> {
        let scene = self.read()?;
        Ok(scene
            .params()
            .infos()
            .iter()
            .map(|i| i.name.clone())
            .collect())
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.keys()?.into_pyobject(py)?.call_method0("__iter__")
    }

    fn __len__(&self) -> PyResult<usize> {
        Ok(self.read()?.params().infos().len())
    }

    fn __contains__(&self, key: &str) -> PyResult<bool> {
        let scene = self.read()?;
        Ok(scene.params().find(key).is_ok() || is_matrix(key) && scene.to_world(key).is_ok())
    }

    fn __getitem__<'py>(
        &self,
        py: Python<'py>,
        key: &str,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let scene = self.read()?;
        if is_matrix(key) {
            let matrix = scene.to_world(key).map_err(Error::from)?.to_f32();
            return array(py, matrix.as_flattened().to_vec(), &[4, 4]);
        }
        let info = one(&scene, key)?;
        array(
            py,
            scene.params().values()[info.range()].to_vec(),
            &shape(info),
        )
    }

    /// The parameter of this name as `scene[key]` has it, or `default` where there is none.
    #[pyo3(signature = (key, default = None))]
    fn get<'py>(
        &self,
        py: Python<'py>,
        key: &str,
        default: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Option<Bound<'py, PyAny>>> {
        match self.__getitem__(py, key) {
            Ok(value) => Ok(Some(value.into_any())),
            Err(e) if e.is_instance_of::<PyKeyError>(py) => Ok(default),
            Err(e) => Err(e),
        }
    }

    /// The values of all parameters, as copies, in the order of their names.
    fn values<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyArrayDyn<f32>>>> {
        let scene = self.read()?;
        let all = scene.params().values();
        let infos = scene.params().infos().iter();
        infos
            .map(|info| array(py, all[info.range()].to_vec(), &shape(info)))
            .collect()
    }

    /// The names of all parameters with their values, as copies.
    fn items<'py>(&self, py: Python<'py>) -> PyResult<Vec<(String, Bound<'py, PyArrayDyn<f32>>)>> {
        Ok(self.keys()?.into_iter().zip(self.values(py)?).collect())
    }

    fn __setitem__(&self, key: &str, value: Bound<'_, PyAny>) -> PyResult<()> {
        self.update(HashMap::from([(key.to_owned(), value)]))
    }

    fn __delitem__(&self, key: &str) -> PyResult<()> {
        Err(PyKeyError::new_err(format!(
            "`{key}`: parameters of a scene cannot be removed"
        )))
    }

    /// Replaces several parameters at once, which may be named by patterns. Nothing has changed where this raises.
    fn update(&self, values: HashMap<String, Bound<'_, PyAny>>) -> PyResult<()> {
        let mut scene = self.write()?;
        let mut values: Vec<_> = values.into_iter().collect();
        // Matrices first, then patterns: who says it more exactly has the last word.
        let order = |key: &str| (!is_matrix(key), !Params::is_pattern(key));
        values.sort_by(|(a, _), (b, _)| (order(a), a).cmp(&(order(b), b)));
        let mut all: Vec<(String, Vec<f32>)> = Vec::new();
        for (key, value) in values {
            let what = format!("parameter `{key}`");
            let value = like(&what, &value)?;
            if is_matrix(&key) {
                all.push((key, arrays::values(&what, &value, &[4, 4])?));
                continue;
            }
            for info in scene.params().matching(&key).map_err(Error::from)? {
                all.push((info.name.clone(), range(info, &value)?));
            }
        }
        let ranges = all.iter().map(|(key, value)| (key, &value[..]));
        Ok(scene.set(ranges).map_err(Error::from)?)
    }

    /// What is known of a parameter: its shape, its valid interval, and what it does to light, which decides on who sees
    /// its derivative.
    fn info<'py>(&self, py: Python<'py>, key: &str) -> PyResult<Bound<'py, PyDict>> {
        let scene = self.read()?;
        let info = one(&scene, key)?;
        let out = PyDict::new(py);
        out.set_item(
            "shape",
            shape(info)
                .into_pyobject(py)?
                .cast_into::<PyList>()?
                .to_tuple(),
        )?;
        out.set_item("valid", info.valid)?;
        out.set_item("kind", info.kind.name())?;
        Ok(out)
    }

    /// Why an estimator is refused in this scene, or for these parameters; `None` if it is not.
    #[pyo3(signature = (estimator, keys = None))]
    fn refusal(
        &self,
        estimator: &str,
        keys: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Option<String>> {
        let scene = self.read()?;
        let e = Estimator::from_name(estimator).map_err(Error::from)?;
        if let Err(reason) = e.check(&scene) {
            return Ok(Some(reason.to_string()));
        }
        let keys = keys.map_or(Ok(Vec::new()), several)?;
        let keys = all_named(&scene, &keys)?;
        Ok(e.active(&scene, &keys).err().map(|e| e.to_string()))
    }

    /// Everything that may move, whether or not it is a parameter by now: names such as `ball.translation`,
    /// `ball.rotation`, `mesh.vertex_positions`, `sensor.fov` or `lamp.position`.
    fn movables(&self) -> PyResult<Vec<String>> {
        let all = self.read()?.movables();
        Ok(all.into_iter().map(|m| m.name).collect())
    }

    /// Makes what is called so parameters, behind all others, with the values that they have: a name, a pattern with `*`
    /// and `?`, or a sequence of those. Until then what may move costs nothing.
    fn make_movable(&self, keys: &Bound<'_, PyAny>) -> PyResult<()> {
        let keys = several(keys)?;
        Ok(self.write()?.make_movable(&keys).map_err(Error::from)?)
    }

    /// The names of all that the scene can be looked at through. Images and gradients are seen through the one that was
    /// named where it was loaded, or the first, unless they name another, by its name or its number.
    #[getter]
    fn sensors(&self) -> PyResult<Vec<String>> {
        let scene = self.read()?;
        Ok(scene.sensors().iter().map(|s| s.name.clone()).collect())
    }

    /// Writes the scene with its parameters as they are into an XML file for this renderer and Mitsuba 3, with its textures
    /// and meshes in folders beside it; the names of all files, the scene last.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<Vec<PathBuf>> {
        let guard = self.read()?;
        let scene: &render::Scene = &guard;
        work(py, 1, None, |_| Ok(scene.save(&path)?))
    }

    /// What was ignored or substituted when the scene was loaded.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.warnings.clone()
    }

    /// The files that the scene was read from.
    #[getter]
    fn files(&self) -> PyResult<Vec<PathBuf>> {
        Ok(self.read()?.files().to_vec())
    }

    /// Height and width of its images, in pixels.
    #[getter]
    fn size(&self) -> PyResult<(usize, usize)> {
        let [width, height] = size(&*self.read()?);
        Ok((height, width))
    }

    /// Samples per pixel, where none are asked for.
    #[getter]
    fn spp(&self) -> PyResult<u32> {
        Ok(self.read()?.settings.spp)
    }

    #[setter]
    fn set_spp(&self, #[pyo3(from_py_with = sample_count)] spp: u32) -> PyResult<()> {
        self.write()?.settings.spp = spp;
        Ok(())
    }

    /// Largest number of edges of a path: 1 is emission only, 2 direct light; -1 for no limit.
    #[getter]
    fn max_depth(&self) -> PyResult<i64> {
        let depth = self.read()?.settings.max_depth;
        Ok(if depth == u32::MAX { -1 } else { depth.into() })
    }

    #[setter]
    fn set_max_depth(&self, depth: i64) -> PyResult<()> {
        let depth = match depth {
            -1 => u32::MAX,
            _ => u32::try_from(depth)
                .ok()
                .filter(|edges| *edges > 0)
                .ok_or_else(|| {
                    PyValueError::new_err(format!(
                        "max_depth: expected -1 for no limit, or at least one edge, found {depth}"
                    ))
                })?,
        };
        self.write()?.settings.max_depth = depth;
        Ok(())
    }

    /// Whether light that the camera sees without a reflection in between is left out.
    #[getter]
    fn hide_emitters(&self) -> PyResult<bool> {
        Ok(self.read()?.settings.hide_emitters)
    }

    #[setter]
    fn set_hide_emitters(&self, hide: bool) -> PyResult<()> {
        self.write()?.settings.hide_emitters = hide;
        Ok(())
    }

    /// How the samples of a pixel are spread: sobol (after loading), independent or antithetic.
    #[getter]
    fn sampler(&self) -> PyResult<&'static str> {
        Ok(name_of(&Points::NAMES, &self.read()?.settings.points))
    }

    #[setter]
    fn set_sampler(&self, name: &str) -> PyResult<()> {
        self.write()?.settings.points = named("sampler", &Points::NAMES, name)?;
        Ok(())
    }

    /// How a point chooses the light that it samples: one (any), or all (in proportion to what each would bring).
    #[getter]
    fn lights(&self) -> PyResult<&'static str> {
        Ok(name_of(&LightChoice::NAMES, &self.read()?.settings.lights))
    }

    #[setter]
    fn set_lights(&self, name: &str) -> PyResult<()> {
        self.write()?.settings.lights = named("lights", &LightChoice::NAMES, name)?;
        Ok(())
    }

    /// The image, height x width x 3, linear RGB, row 0 at the top; in single precision unless `double` is set. The same
    /// seed gives the same bits. `sensor` is what it is seen through, at its resolution and with its samples per pixel;
    /// nobody else can use the scene meanwhile where it is not the scene's own. `estimator` chooses the techniques.
    /// `progress` is called with the part that is done.
    #[pyo3(signature = (*, spp = None, seed = 0, sensor = None, estimator = "mis", double = false, progress = None))]
    #[expect(clippy::too_many_arguments, reason = "Python names them")]
    fn render<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = some_samples)] spp: Option<u32>,
        #[pyo3(from_py_with = seed_from)] seed: u64,
        sensor: Option<&Bound<'py, PyAny>>,
        estimator: &str,
        double: bool,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let guard = self.through(sensor)?;
        let scene: &render::Scene = &guard;
        let settings = settings(scene, spp);
        let estimator = Estimator::from_name(estimator).map_err(Error::from)?;
        let total = scene.film.pixels() as u64;
        let found = work(py, total, progress.as_ref(), |progress| {
            let job = Job::new(scene, &settings, seed, 0..settings.spp.into(), progress);
            Ok(if double {
                let values: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
                render_f64(&job, &Theta::constant(&values), estimator)
            } else {
                render_f32(&job, &Theta::constant(scene.params().values()), estimator)
            })
        })?;
        warn_of(py, &found.non_finite, found.width, seed)?;
        if double {
            let scale = 1.0 / found.samples.max(1) as f64;
            let means = found.sums[0].iter().map(|x| x * scale).collect();
            Ok(image::<f64>(py, means, size(scene))?.into_any())
        } else {
            Ok(image::<f32>(py, found.image(0).data, size(scene))?.into_any())
        }
    }

    /// How much of each pixel is covered, height x width: the fourth channel of the image with the same samples and seed.
    /// Everything is where the sky is seen, unless `hide_emitters` is set.
    #[pyo3(signature = (*, spp = None, seed = 0, sensor = None))]
    fn alpha<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = some_samples)] spp: Option<u32>,
        #[pyo3(from_py_with = seed_from)] seed: u64,
        sensor: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let guard = self.through(sensor)?;
        let scene: &render::Scene = &guard;
        let settings = settings(scene, spp);
        let found = work(py, 1, None, |progress| {
            let job = Job::new(scene, &settings, seed, 0..settings.spp.into(), progress);
            Ok(coverage(&job).unwrap_or_default())
        })?;
        let [width, height] = size(scene);
        array(py, found, &[height, width])
    }

    /// The gradient of the sum of `adjoint * image` in the parameters `keys`, a dict of arrays in their shapes.
    ///
    /// `adjoint` is the derivative of an objective in every entry of the image, as `loss` gives it. It has to come from an
    /// image with another seed than this one; the defaults of `render` and of this differ. Without keys: all parameters
    /// that the estimator sees. `*` and `?` in a key stand for any text and any character. `sensor` as in `render`.
    #[pyo3(signature = (adjoint, keys = None, *, estimator = "mis", spp = None, seed = 1, sensor = None, progress = None))]
    #[expect(clippy::too_many_arguments, reason = "Python names them")]
    fn backward<'py>(
        &self,
        py: Python<'py>,
        adjoint: Like<'py>,
        keys: Option<&Bound<'py, PyAny>>,
        estimator: &str,
        #[pyo3(from_py_with = some_samples)] spp: Option<u32>,
        #[pyo3(from_py_with = seed_from)] seed: u64,
        sensor: Option<&Bound<'py, PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let guard = self.through(sensor)?;
        let scene: &render::Scene = &guard;
        let settings = settings(scene, spp);
        let adjoint = pixels("adjoint", &adjoint, size(scene))?;
        let estimator = or_auto(estimator).map_err(Error::from)?;
        let keys = keys.map_or_else(
            || Ok(seen(scene, estimator)),
            |keys| all_named(scene, &several(keys)?),
        )?;
        let infos = keys.iter().map(|k| scene.params().find(k));
        let infos: Vec<ParamInfo> = infos
            .map(|i| i.cloned())
            .collect::<Result<_, _>>()
            .map_err(Error::from)?;
        if let Some(estimator) = estimator {
            warn_of_doubts(py, scene, estimator, &keys)?;
        }
        let total = scene.film.pixels() as u64;
        let found = work(py, total, progress.as_ref(), |progress| {
            let job = Job::new(scene, &settings, seed, 0..settings.spp.into(), progress);
            let chosen = mixture(scene, &keys, &adjoint, estimator, &job, Mode::Reverse)?;
            let theta = Theta::constant(scene.params().values());
            Ok(chosen.backward_f32(&job, &theta, &keys, &adjoint)?)
        })?;
        warn_of(py, &found.non_finite, size(scene)[0], seed)?;
        let out = PyDict::new(py);
        for (info, values) in infos.iter().zip(found.values) {
            out.set_item(&info.name, array(py, values, &shape(info))?)?;
        }
        Ok(out)
    }

    /// The derivative of the image, height x width x 3, when a parameter moves: when one number is added to all of it, or
    /// along `directions`, a dict of arrays in the shapes of the parameters (or of one number each), whose sum it is.
    ///
    /// Colours do not mix: moving all channels of a colour gives, in channel c, the derivative in channel c.
    /// Names may be patterns, as in `backward`. `sensor` as in `render`.
    #[pyo3(signature = (directions, *, estimator = "mis", spp = None, seed = 1, sensor = None, progress = None))]
    #[expect(clippy::too_many_arguments, reason = "Python names them")]
    fn forward<'py>(
        &self,
        py: Python<'py>,
        directions: &Bound<'py, PyAny>,
        estimator: &str,
        #[pyo3(from_py_with = some_samples)] spp: Option<u32>,
        #[pyo3(from_py_with = seed_from)] seed: u64,
        sensor: Option<&Bound<'py, PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let guard = self.through(sensor)?;
        let scene: &render::Scene = &guard;
        let settings = settings(scene, spp);
        let along = self::directions(scene, directions)?;
        let e = Estimator::from_name(estimator).map_err(Error::from)?;
        let names: Vec<&str> = along.iter().map(|(name, _)| name.as_str()).collect();
        e.check(scene).map_err(Error::from)?;
        e.active(scene, &names).map_err(Error::from)?;
        warn_of_doubts(py, scene, e, &names)?;
        let along: Vec<Direction> = along.into_iter().map(|(_, d)| d).collect();
        let total = scene.film.pixels() as u64;
        let found = work(py, total, progress.as_ref(), |progress| {
            let job = Job::new(scene, &settings, seed, 0..settings.spp.into(), progress);
            Ok(e.forward_f32(&job, scene.params().values(), &along)?)
        })?;
        warn_of(py, &found.non_finite, found.width, seed)?;
        image(py, found.image(1).data, size(scene))
    }

    /// Compares the gradient with central differences in double precision, and says whether it is right, wrong, or not to
    /// be told at this budget: `spp` samples per pixel in each of `repeats` repeats. The objective is the mean of all pixels
    /// and channels, unless an `adjoint` is given. A derivative is right if an error of `tolerance`, relative to the others
    /// of its parameter, would have been noticed. The scene cannot be used by others meanwhile.
    #[pyo3(signature = (keys = None, *, estimator = "mis", adjoint = None, spp = None, repeats = 32, tolerance = 0.1,
                        significance = 1e-3, seed = 0, sensor = None, progress = None))]
    #[expect(clippy::too_many_arguments, reason = "Python names them")]
    fn check<'py>(
        &self,
        py: Python<'py>,
        keys: Option<&Bound<'py, PyAny>>,
        estimator: &str,
        adjoint: Option<Like<'py>>,
        #[pyo3(from_py_with = some_samples)] spp: Option<u32>,
        #[pyo3(from_py_with = repeats_from)] repeats: u32,
        tolerance: f64,
        significance: f64,
        #[pyo3(from_py_with = seed_from)] seed: u64,
        sensor: Option<&Bound<'py, PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Check> {
        let mut guard = self.alone(sensor)?;
        let scene: &mut render::Scene = &mut guard;
        let settings = settings(scene, spp);
        let adjoint = match adjoint {
            Some(adjoint) => pixels("adjoint", &adjoint, size(scene))?,
            None => {
                let n = scene.film.pixels() * 3;
                vec![(1.0 / n as f64) as f32; n]
            }
        };
        let estimator = or_auto(estimator).map_err(Error::from)?;
        let keys = keys.map_or_else(
            || Ok(seen(scene, estimator)),
            |keys| all_named(scene, &several(keys)?),
        )?;
        let options = Options {
            repeats,
            tolerance,
            significance,
            seed,
        };
        let passes = most_passes(scene, &keys, &options);
        let total = passes.saturating_mul(scene.film.pixels() as u64);
        let report = work(py, total, progress.as_ref(), |progress: &dyn Progress| {
            let budget = u64::from(settings.spp) * u64::from(repeats);
            let job = Job::new(scene, &settings, seed, 0..budget, progress);
            let chosen = mixture(scene, &keys, &adjoint, estimator, &job, Mode::Reverse)?;
            Ok(check(
                scene, &settings, &keys, &chosen, &adjoint, &options, progress,
            )?)
        })?;
        let stopped = || PyRuntimeError::new_err("the check was stopped");
        report.map(Check).ok_or_else(stopped)
    }

    fn __repr__(&self) -> PyResult<String> {
        let scene = self.read()?;
        let ([width, height], n) = (size(&scene), scene.params().infos().len());
        Ok(format!(
            "<scene of {height} x {width} pixels, {n} parameters>"
        ))
    }
}

/// Which parameters move, and how: a name, a sequence of names, or a mapping from names to arrays or numbers.
fn directions(
    scene: &render::Scene,
    along: &Bound<'_, PyAny>,
) -> PyResult<Vec<(String, Direction)>> {
    let Ok(mapping) = along.cast::<PyMapping>() else {
        let named = all_named(scene, &several(along)?)?.into_iter().map(|name| {
            let uniform = Direction::uniform(scene.params(), &name).map_err(Error::from)?;
            Ok((name, uniform))
        });
        return named.collect();
    };
    if mapping.is_empty()? {
        return Err(PyValueError::new_err(
            "directions: expected at least one parameter, found none",
        ));
    }
    let mut out = Vec::new();
    for item in mapping.items()? {
        let (name, values): (String, Bound<'_, PyAny>) = item.extract()?;
        let info = one(scene, &name)?;
        let values = range(info, &like(&format!("direction of `{name}`"), &values)?)?;
        if let Some(bad) = values.iter().find(|v| !v.is_finite()) {
            return Err(PyValueError::new_err(format!(
                "direction of `{name}`: expected finite numbers, found {bad}"
            )));
        }
        out.push((name, Direction::Dense(scene.params().handle(info), values)));
    }
    Ok(out)
}
