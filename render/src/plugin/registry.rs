//! Where plugins that are being built put their parameters.

use std::any::{Any, TypeId};
use std::collections::HashMap;
use std::sync::Arc;

use super::{Attributes, Node, Origins};
use crate::error::SceneError;
use crate::params::{ParamRef, ParamShape, Params};

/// Something built from a node: the node, its type, and what else it depends on.
type Key = (*const Node, TypeId, [u64; 3]);

/// The parameters of a scene that is being built, and what its plugins share.
///
/// Methods that make textures and materials of it stand with those, in [`crate::texture`] and [`crate::bsdf`].
#[derive(Debug, Default)]
pub struct Registry {
    params: Params,
    /// Name that the parameters of the plugin being built start with.
    prefix: String,
    /// Built from nodes that several places may refer to.
    shared: HashMap<Key, Arc<dyn Any + Send + Sync>>,
    /// Index that the shape under construction will have, while its emitter is built.
    open_shape: Option<u32>,
    /// Of the mesh that is being built, if textures of its shape ask for some.
    pub(crate) attributes: Option<Attributes>,
    /// Which parts of the file hold which parameters.
    pub(crate) origins: Origins,
    /// Substitute mid-grey for missing texture files.
    pub allow_missing: bool,
    /// What was ignored or substituted.
    pub warnings: Vec<String>,
}

impl Registry {
    /// The parameters so far.
    pub fn params(&self) -> &Params {
        &self.params
    }

    /// The parameters, once all plugins are built.
    pub(crate) fn into_params(self) -> Params {
        self.params
    }

    /// The parameters, to be finished.
    pub(crate) fn params_mut(&mut self) -> &mut Params {
        &mut self.params
    }

    /// Adds a range of parameters after checking its values.
    pub(crate) fn push_param(
        &mut self,
        name: &str,
        shape: ParamShape,
        values: &[f64],
        valid: (f64, f64),
    ) -> Result<ParamRef, SceneError> {
        if let Some(bad) = values
            .iter()
            .find(|&&v| !(v.is_finite() && v >= valid.0 && v <= valid.1))
        {
            return Err(SceneError::Parameter {
                key: name.into(),
                expected: range_text(valid),
                found: bad.to_string(),
            });
        }
        let values: Vec<f32> = values.iter().map(|&v| v as f32).collect();
        Ok(self.params.push(name, shape, &values, valid))
    }

    /// Adds a range of texels that were checked. `None` if the parameters do not fit their 32-bit index.
    pub(crate) fn push_texels(
        &mut self,
        name: &str,
        shape: ParamShape,
        texels: &[f32],
        valid: (f64, f64),
    ) -> Option<ParamRef> {
        u32::try_from(self.params.values().len() + texels.len()).ok()?;
        Some(self.params.push(name, shape, texels, valid))
    }

    /// What was built before from `node`, for equal `details`.
    pub(crate) fn shared<T: Any + Send + Sync>(
        &self,
        node: &Arc<Node>,
        details: [u64; 3],
    ) -> Option<Arc<T>> {
        let key = (Arc::as_ptr(node), TypeId::of::<T>(), details);
        self.shared.get(&key)?.clone().downcast().ok()
    }

    /// Keeps something for [`Registry::shared`].
    pub(crate) fn share<T: Any + Send + Sync>(
        &mut self,
        node: &Arc<Node>,
        details: [u64; 3],
        built: Arc<T>,
    ) {
        let key = (Arc::as_ptr(node), TypeId::of::<T>(), details);
        self.shared.insert(key, built);
    }

    /// The name of the plugin being built: parameters are called `{prefix}.{key}.value`.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Runs `f` with another parameter prefix.
    pub(crate) fn called<T>(&mut self, name: String, f: impl FnOnce(&mut Self) -> T) -> T {
        let outer = std::mem::replace(&mut self.prefix, name);
        let result = f(self);
        self.prefix = outer;
        result
    }

    /// Index of the shape that the emitter being built belongs to.
    ///
    /// # Errors
    /// The emitter stands outside a shape.
    pub fn current_shape(&self, node: &Node) -> Result<u32, SceneError> {
        self.open_shape
            .ok_or_else(|| node.missing("shape", "an area light inside a <shape>"))
    }

    /// Runs `f` with the parameter prefix `name`, inside the shape with this index, if there is one.
    pub(crate) fn within<T>(
        &mut self,
        name: &str,
        shape: Option<u32>,
        f: impl FnOnce(&mut Self) -> Result<T, SceneError>,
    ) -> Result<T, SceneError> {
        self.open_shape = shape;
        let result = self.called(name.to_owned(), f);
        self.open_shape = None;
        result
    }
}

/// A range of numbers, for messages.
pub(crate) fn range_text((lo, hi): (f64, f64)) -> String {
    match (lo.is_finite(), hi.is_finite()) {
        (true, true) => format!("a number in [{lo}, {hi}]"),
        (true, false) => format!("a finite number of at least {lo}"),
        _ => "a finite number".into(),
    }
}
