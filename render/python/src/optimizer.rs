//! Optimisers that move the parameters of a scene.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use optim::{AnyOptimizer, Constrained, Groups, Optimizer as _, Parameterisation, Rates};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use render::params::ParamInfo;

use crate::arrays::{like, range};
use crate::error::Error;
use crate::scene::{Scene, all_named, several};

/// Moves parameters of a scene against gradients. They stay within their valid intervals; positive ones of unknown
/// magnitude, such as roughness and radiance, move by factors.
///
/// `method` is adam or sgd. `rate` is the learning rate, that usual for the method if it is not given; a dict gives
/// some parameters rates of their own.
#[pyclass(frozen, module = "render_gradients")]
pub struct Optimizer {
    scene: Py<Scene>,
    infos: Vec<ParamInfo>,
    inner: Mutex<Constrained<AnyOptimizer<f32>, f32>>,
}

#[pymethods]
impl Optimizer {
    #[new]
    #[pyo3(signature = (scene, keys, *, rate = None, method = "adam", rates = None))]
    fn new(
        py: Python<'_>,
        scene: Py<Scene>,
        keys: &Bound<'_, PyAny>,
        rate: Option<f64>,
        method: &str,
        rates: Option<HashMap<String, f64>>,
    ) -> PyResult<Self> {
        let keys = several(keys)?;
        let mut infos: Vec<ParamInfo> = Vec::new();
        let mut values = Vec::new();
        {
            let inside = scene.get().read()?;
            for key in all_named(&inside, &keys)? {
                let info = inside.params().find(&key).map_err(Error::from)?;
                infos.push(info.clone());
                values.extend_from_slice(&inside.params().values()[info.range()]);
            }
        }
        let inner = of(&infos, &values, rate, method, rates.unwrap_or_default());
        let inner = Mutex::new(inner.map_err(PyErr::from)?);
        let scene = scene.clone_ref(py);
        Ok(Self {
            scene,
            infos,
            inner,
        })
    }

    /// Moves the parameters by one step that reduces the objective, and tells the scene. `gradient` has an array for
    /// every key, as `Scene.backward` gives it, and no other. Nothing has moved where this raises.
    fn step(&self, gradient: HashMap<String, Bound<'_, PyAny>>) -> PyResult<()> {
        let own = self.keys();
        let mut strangers: Vec<&str> = gradient.keys().map(String::as_str).collect();
        strangers.retain(|key| !own.contains(key));
        strangers.sort_unstable();
        if !strangers.is_empty() {
            return Err(PyValueError::new_err(format!(
                "gradient: expected arrays for {}, found some for {}, too",
                own.join(", "),
                strangers.join(", ")
            )));
        }
        let mut flat = Vec::new();
        for info in &self.infos {
            let own = gradient.get(&info.name).ok_or_else(|| {
                let name = &info.name;
                PyValueError::new_err(format!(
                    "gradient: expected an array for `{name}`, found none"
                ))
            })?;
            let own = like(&format!("gradient of `{}`", info.name), own)?;
            flat.extend(range(info, &own)?);
        }
        let mut scene = self.scene.get().write()?;
        let mut values = scene.params().values().to_vec();
        let ranges = || self.infos.iter().map(ParamInfo::range);
        let mut moved: Vec<f32> = ranges().flat_map(|r| values[r].to_vec()).collect();
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let mut next = inner.clone();
        next.step(&mut moved, &flat).map_err(Error::from)?;
        let mut rest = &moved[..];
        for r in ranges() {
            let (own, later) = rest.split_at(r.len());
            values[r].copy_from_slice(own);
            rest = later;
        }
        scene.set_params(&values).map_err(Error::from)?;
        *inner = next;
        Ok(())
    }

    /// The names of the parameters.
    #[getter]
    fn keys(&self) -> Vec<&str> {
        self.infos.iter().map(|i| i.name.as_str()).collect()
    }

    /// How many steps were made.
    #[getter]
    fn steps(&self) -> u64 {
        self.inner
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .steps()
    }
}

fn of(
    infos: &[ParamInfo],
    values: &[f32],
    rate: Option<f64>,
    method: &str,
    rates: HashMap<String, f64>,
) -> Result<Constrained<AnyOptimizer<f32>, f32>, Error> {
    // An unknown name is an error of the optimiser, below.
    let rate = rate
        .or(AnyOptimizer::<f32>::usual_rate(method))
        .unwrap_or(1.0);
    let inner = AnyOptimizer::new(method, Rates::new(values.len(), rate)?)?;
    let mut groups = Groups::new(values.len());
    let mut at = 0;
    for info in infos {
        let range = at..at + info.shape.len();
        at = range.end;
        let map = Parameterisation::usual(info.valid, &values[range.clone()])?;
        groups.add(info.name.clone(), range, map)?;
    }
    let mut inner = Constrained::new(inner, groups)?;
    for (name, rate) in rates {
        inner.set_rate(&name, rate)?;
    }
    Ok(inner)
}
