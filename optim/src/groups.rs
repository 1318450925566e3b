//! Named ranges of the parameter vector with their own learning rate, bounds and variables.

use crate::bounds::Parameterisation;
use crate::coarse::Coarse;
use crate::diffusion::Diffusion;
use crate::error::{OptimError, require_len};
use crate::optimizer::{Optimizer, check_inputs, require_finite};
use crate::rates::Rates;
use crate::scalar::Scalar;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// A named range of the parameter vector.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Group {
    /// The name in error messages; a scene's parameter key, for instance.
    pub name: String,
    /// The entries.
    pub range: Range<usize>,
    /// How the entries depend on what the optimiser moves.
    pub parameterisation: Parameterisation,
    /// The graph along which the entries move together, where they do ([`Groups::tie`]); the parameterisation is the
    /// identity then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diffusion: Option<Diffusion>,
    /// The image whose texels the entries are, where it begins coarse ([`Groups::coarsen`]).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coarse: Option<Coarse>,
}

/// Disjoint named ranges of a parameter vector; entries outside all of them are unbounded.
///
/// ```
/// use optim::{Groups, Parameterisation};
///
/// let mut groups = Groups::new(5);
/// groups.add("glass.alpha", 0..1, Parameterisation::log_within(1e-4, 1.0)?)?;
/// groups.add("wall.reflectance", 1..4, Parameterisation::bounded(0.0, 1.0)?)?;
/// assert_eq!(groups.group_of(2).map(|g| g.name.as_str()), Some("wall.reflectance"));
/// assert!(groups.group_of(4).is_none()); // it has no bounds
/// assert!(groups.add("again", 3..5, Parameterisation::Identity).is_err()); // entries have one group
/// # Ok::<(), optim::OptimError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawGroups")]
pub struct Groups {
    len: usize,
    groups: Vec<Group>,
}

#[derive(Deserialize)]
struct RawGroups {
    len: usize,
    groups: Vec<Group>,
}

impl TryFrom<RawGroups> for Groups {
    type Error = OptimError;
    fn try_from(raw: RawGroups) -> Result<Self, OptimError> {
        let mut groups = Self::new(raw.len);
        for g in raw.groups {
            groups.add(g.name.clone(), g.range, g.parameterisation)?;
            if let Some(diffusion) = g.diffusion {
                groups.tie(&g.name, diffusion)?;
            }
            if let Some(coarse) = g.coarse {
                groups.coarsen(&g.name, coarse)?;
            }
        }
        Ok(groups)
    }
}

impl Groups {
    /// No groups yet over `len` parameters.
    pub fn new(len: usize) -> Self {
        Self {
            len,
            groups: Vec::new(),
        }
    }

    /// Adds a group of at least one entry; its name and its entries must be new.
    ///
    /// # Errors
    /// A range that is empty or ends behind the vector, wrong bounds, a name or entries that another group has.
    pub fn add(
        &mut self,
        name: impl Into<String>,
        range: Range<usize>,
        parameterisation: Parameterisation,
    ) -> Result<(), OptimError> {
        // An empty range has no place among the others: it may share its start with the next.
        if range.is_empty() || range.end > self.len {
            return Err(OptimError::Range {
                range,
                len: self.len,
            });
        }
        let group = Group {
            name: name.into(),
            range,
            parameterisation: parameterisation.validated()?,
            diffusion: None,
            coarse: None,
        };
        let at = self
            .groups
            .partition_point(|g| g.range.start < group.range.start);
        let clash = self.groups.iter().find(|g| {
            let overlap = g.range.start < group.range.end && group.range.start < g.range.end;
            g.name == group.name || overlap
        });
        if let Some(first) = clash {
            let first = first.name.clone();
            return Err(OptimError::GroupConflict {
                first,
                second: group.name,
            });
        }
        self.groups.insert(at, group);
        Ok(())
    }

    /// Lets the entries of a group move together along a graph: `[vertex][component]` in order.
    ///
    /// # Errors
    /// There is no such group, its entries are no whole number per vertex, or they have bounds or variables of their own.
    pub fn tie(&mut self, name: &str, diffusion: Diffusion) -> Result<(), OptimError> {
        let Some(group) = self.groups.iter_mut().find(|g| g.name == name) else {
            return Err(self.unknown(name));
        };
        let (entries, vertices) = (group.range.len(), diffusion.vertices());
        if vertices == 0 || entries % vertices != 0 {
            return Err(OptimError::Tied {
                group: name.to_owned(),
                expected: format!("a multiple of {vertices} entries, the number of vertices"),
                found: format!("{entries}"),
            });
        }
        if group.parameterisation != Parameterisation::Identity {
            return Err(OptimError::Tied {
                group: name.to_owned(),
                expected: "entries without bounds and variables of their own".to_owned(),
                found: format!("{:?}", group.parameterisation),
            });
        }
        if group.coarse.is_some() {
            return Err(OptimError::Tied {
                group: name.to_owned(),
                expected: "entries that begin at their own resolution".to_owned(),
                found: "a coarse one".to_owned(),
            });
        }
        group.diffusion = Some(diffusion);
        Ok(())
    }

    /// Lets the entries of a group, texels of an image, begin coarse. Bounds and variables are those of coarse texels.
    ///
    /// # Errors
    /// There is no such group, its entries are not those of the image, or they are tied.
    pub fn coarsen(&mut self, name: &str, coarse: Coarse) -> Result<(), OptimError> {
        let Some(group) = self.groups.iter_mut().find(|g| g.name == name) else {
            return Err(self.unknown(name));
        };
        let wrong = |expected: String, found: String| OptimError::Tied {
            group: name.to_owned(),
            expected,
            found,
        };
        if coarse.len() != group.range.len() {
            let expected = format!("{} entries, those of the image", coarse.len());
            return Err(wrong(expected, group.range.len().to_string()));
        }
        if group.diffusion.is_some() {
            let expected = "entries that move by themselves".to_owned();
            return Err(wrong(expected, "tied ones".to_owned()));
        }
        group.coarse = Some(coarse);
        Ok(())
    }

    /// The error that no group has this name.
    fn unknown(&self, name: &str) -> OptimError {
        let known: Vec<_> = self.groups.iter().map(|g| g.name.as_str()).collect();
        OptimError::UnknownName {
            what: "group",
            expected: known.join(", "),
            found: name.to_owned(),
        }
    }

    /// Number of parameters, in groups or not.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no parameters.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The groups in the order of their ranges.
    pub fn iter(&self) -> impl Iterator<Item = &Group> {
        self.groups.iter()
    }

    /// The group of that name.
    pub fn get(&self, name: &str) -> Option<&Group> {
        self.groups.iter().find(|g| g.name == name)
    }

    /// The group that holds an entry.
    pub fn group_of(&self, index: usize) -> Option<&Group> {
        self.groups.iter().find(|g| g.range.contains(&index))
    }

    /// Names the group in an error that has an index.
    pub(crate) fn locate(&self, mut error: OptimError) -> OptimError {
        match &mut error {
            OptimError::NonFiniteGradient { index, group, .. }
            | OptimError::NonFiniteValue { index, group, .. }
            | OptimError::OutOfDomain { index, group, .. } => {
                *group = self.group_of(*index).map(|g| g.name.clone());
            }
            _ => {}
        }
        error
    }

    /// Variables for physical values at a step. A variable that already stands for its value is kept: it may
    /// hold more digits than the value.
    pub(crate) fn refresh<T: Scalar>(
        &self,
        step: u64,
        params: &[T],
        variables: &mut [T],
    ) -> Result<(), OptimError> {
        let mut end = 0;
        for group in &self.groups {
            variables[end..group.range.start].copy_from_slice(&params[end..group.range.start]);
            end = group.range.end;
            if let Some(diffusion) = &group.diffusion {
                let (params, variables) = (
                    &params[group.range.clone()],
                    &mut variables[group.range.clone()],
                );
                let mut stands_for = vec![T::default(); params.len()];
                diffusion.values(variables, &mut stands_for);
                if stands_for != params {
                    diffusion.variables(params, variables);
                }
                continue;
            }
            let map = group.parameterisation;
            let mut coarse = None;
            if let Some(image) = &group.coarse {
                let own = &params[group.range.clone()];
                let mut values: Vec<T> = (variables[group.range.clone()].iter())
                    .map(|u| map.forward(*u))
                    .collect();
                image.values(step, &mut values);
                if values == own {
                    continue;
                }
                values.copy_from_slice(own);
                image.variables(step, &mut values);
                coarse = Some(values);
            }
            for index in group.range.clone() {
                let value = match &coarse {
                    Some(values) => values[index - group.range.start],
                    None => params[index],
                };
                if map.forward(variables[index]) == value {
                    continue;
                }
                variables[index] = map.inverse(value).ok_or_else(|| OptimError::OutOfDomain {
                    index,
                    value: value.to_f64(),
                    group: Some(group.name.clone()),
                    expected: map.domain(),
                })?;
            }
        }
        variables[end..].copy_from_slice(&params[end..]);
        Ok(())
    }

    /// The gradient with respect to the variables: `g * dp/du`.
    pub(crate) fn pull_back<T: Scalar>(
        &self,
        step: u64,
        variables: &[T],
        grad: &[T],
    ) -> Result<Vec<T>, OptimError> {
        let mut out = grad.to_vec();
        for group in &self.groups {
            if let Some(diffusion) = &group.diffusion {
                diffusion.pull_back(&mut out[group.range.clone()]);
            }
            if let Some(coarse) = &group.coarse {
                coarse.pull_back(step, &mut out[group.range.clone()]);
            }
            for index in group.range.clone() {
                out[index] = out[index] * group.parameterisation.derivative(variables[index]);
                if !out[index].is_finite() {
                    return Err(OptimError::Overflow {
                        what: "chain rule",
                        index,
                    });
                }
            }
        }
        Ok(out)
    }

    /// How an entry depends on its variable.
    pub(crate) fn map_of(&self, index: usize) -> Parameterisation {
        self.group_of(index)
            .map_or(Parameterisation::Identity, |g| g.parameterisation)
    }

    /// Projects variables that have moved from `old` to `new` and gives the parameters behind them their
    /// values; the others keep their bits.
    pub(crate) fn apply<T: Scalar>(&self, step: u64, old: &[T], new: &mut [T], params: &mut [T]) {
        let mut end = 0;
        for group in &self.groups {
            params[end..group.range.start].copy_from_slice(&new[end..group.range.start]);
            end = group.range.end;
            if let Some(diffusion) = &group.diffusion {
                let range = group.range.clone();
                if new[range.clone()] != old[range.clone()] {
                    diffusion.values(&new[range.clone()], &mut params[range]);
                }
                continue;
            }
            let map = group.parameterisation;
            if let Some(coarse) = &group.coarse {
                let range = group.range.clone();
                (new[range.clone()].iter_mut()).for_each(|u| *u = map.project(*u));
                if new[range.clone()] != old[range.clone()] {
                    let own = &mut params[range.clone()];
                    (own.iter_mut().zip(&new[range])).for_each(|(p, u)| *p = map.forward(*u));
                    coarse.values(step, own);
                }
                continue;
            }
            for i in group.range.clone() {
                new[i] = map.project(new[i]);
                let outside = {
                    let (lo, hi) = map.range::<T>();
                    params[i] < lo || params[i] > hi
                };
                if new[i] != old[i] || outside {
                    params[i] = map.forward(new[i]);
                }
            }
        }
        params[end..].copy_from_slice(&new[end..]);
    }
}

/// An optimiser over physical parameters that moves the variables of [`Groups`] behind them.
///
/// `step` takes physical values and the gradient with respect to them. Values that the caller has
/// changed between two steps are honoured; a value whose variable does not move keeps its bits.
/// The learning rates are those of the inner optimiser, in units of the variables.
///
/// ```
/// use optim::{Adam, Constrained, Groups, Optimizer, Parameterisation};
///
/// let mut groups = Groups::new(3);
/// groups.add("wall.reflectance", 0..3, Parameterisation::bounded(0.0, 1.0)?)?;
/// let mut optimizer = Constrained::new(Adam::new(3, 0.2)?, groups)?;
/// optimizer.set_rate("wall.reflectance", 0.1)?;
/// let mut colour = [0.5f64, 0.95, 0.05];
/// optimizer.step(&mut colour, &[0.0, -1.0, 1.0])?; // the gradient is that of the colour itself
/// assert_eq!(colour[0], 0.5);
/// assert!(colour.iter().all(|c| (0.0..=1.0).contains(c)) && colour[1] > 0.95 && colour[2] < 0.05);
/// # Ok::<(), optim::OptimError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(
    try_from = "RawConstrained<O, T>",
    bound(
        serialize = "O: Serialize",
        deserialize = "O: Optimizer<T> + Deserialize<'de>"
    )
)]
pub struct Constrained<O, T: Scalar> {
    inner: O,
    groups: Groups,
    #[serde(with = "crate::exact::slice")]
    variables: Vec<T>,
}

#[derive(Deserialize)]
#[serde(bound(deserialize = "O: Deserialize<'de>"))]
struct RawConstrained<O, T: Scalar> {
    inner: O,
    groups: Groups,
    #[serde(with = "crate::exact::slice")]
    variables: Vec<T>,
}

impl<O: Optimizer<T>, T: Scalar> TryFrom<RawConstrained<O, T>> for Constrained<O, T> {
    type Error = OptimError;
    fn try_from(raw: RawConstrained<O, T>) -> Result<Self, OptimError> {
        let RawConstrained {
            inner,
            groups,
            variables,
        } = raw;
        require_len("rates", groups.len(), inner.rates().len())?;
        require_len("variables", groups.len(), variables.len())?;
        require_finite("variables", &variables)?;
        Ok(Self {
            inner,
            groups,
            variables,
        })
    }
}

impl<O: Optimizer<T>, T: Scalar> Constrained<O, T> {
    /// An optimiser for the variables of the groups; both over the same number of parameters.
    ///
    /// # Errors
    /// Different numbers of parameters.
    pub fn new(mut inner: O, groups: Groups) -> Result<Self, OptimError> {
        require_len("rates", groups.len(), inner.rates().len())?;
        for group in groups.iter() {
            inner.rates_mut().separate(&group.range)?;
            if group.diffusion.is_some() {
                inner.rates_mut().tie(group.range.clone())?;
            }
        }
        // Any start will do: the first step replaces what does not stand for its value.
        let variables = vec![T::default(); groups.len()];
        Ok(Self {
            inner,
            groups,
            variables,
        })
    }

    /// Gives the group of that name its own learning rate.
    ///
    /// # Errors
    /// There is no such group, or the rate is not positive and finite.
    pub fn set_rate(&mut self, name: &str, rate: f64) -> Result<(), OptimError> {
        let Some(group) = self.groups.get(name) else {
            return Err(self.groups.unknown(name));
        };
        let range = group.range.clone();
        self.inner.rates_mut().set_rate(range, rate)
    }

    /// The groups.
    pub fn groups(&self) -> &Groups {
        &self.groups
    }

    /// The optimiser of the variables.
    pub fn inner(&self) -> &O {
        &self.inner
    }
}

impl<O: Optimizer<T>, T: Scalar> Optimizer<T> for Constrained<O, T> {
    fn step(&mut self, params: &mut [T], grad: &[T]) -> Result<(), OptimError> {
        let groups = &self.groups;
        check_inputs(groups.len(), params, grad).map_err(|e| groups.locate(e))?;
        let mut old = self.variables.clone();
        let step = self.inner.steps();
        groups.refresh(step, params, &mut old)?;
        let grad = groups.pull_back(step, &old, grad)?;
        let mut new = old.clone();
        self.inner
            .step(&mut new, &grad)
            .map_err(|e| groups.locate(e))?;

        groups.apply(step, &old, &mut new, params);
        self.variables = new;
        Ok(())
    }

    fn steps(&self) -> u64 {
        self.inner.steps()
    }
    fn rates(&self) -> &Rates {
        self.inner.rates()
    }
    fn rates_mut(&mut self) -> &mut Rates {
        self.inner.rates_mut()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Adam, AdamOptions, AnyOptimizer, Schedule, Sgd, SgdOptions};
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    fn one(map: Parameterisation) -> Groups {
        let mut groups = Groups::new(1);
        groups.add("p", 0..1, map).unwrap();
        groups
    }

    fn momentum(len: usize, rate: f64, momentum: f64) -> Sgd<f64> {
        let options = SgdOptions {
            momentum,
            ..Default::default()
        };
        Sgd::with_options(Rates::new(len, rate).unwrap(), options).unwrap()
    }

    #[test]
    fn chain_rule_by_hand() {
        // u = ln 2, g_u = 3 * 2, u' = ln 2 - 0.6.
        let mut o = Constrained::new(momentum(1, 0.1, 0.0), one(Parameterisation::log())).unwrap();
        let mut p = [2.0];
        o.step(&mut p, &[3.0]).unwrap();
        assert_relative_eq!(p[0], 2.0 * (-0.6f64).exp(), epsilon = 1e-15);
        // p = 1 / (1 + e^-u) at u = 0: dp/du = 1/4.
        let sigmoid = Parameterisation::sigmoid(0.0, 1.0).unwrap();
        let mut o = Constrained::new(momentum(1, 0.1, 0.0), one(sigmoid)).unwrap();
        let mut p = [0.5];
        o.step(&mut p, &[-4.0]).unwrap();
        assert_relative_eq!(p[0], 1.0 / (1.0 + (-0.1f64).exp()), epsilon = 1e-15);
    }

    #[test]
    fn groups_have_their_own_rate_and_the_rest_is_plain() {
        let mut groups = Groups::new(4);
        groups
            .add("b", 2..3, Parameterisation::bounded(0.0, 1.0).unwrap())
            .unwrap();
        groups.add("a", 0..1, Parameterisation::Identity).unwrap();
        let mut o = Constrained::new(momentum(4, 0.1, 0.0), groups).unwrap();
        o.set_rate("b", 0.01).unwrap();
        let mut p = [0.5; 4];
        o.step(&mut p, &[1.0; 4]).unwrap();
        assert_eq!(p, [0.4, 0.4, 0.49, 0.4]);
        o.step(&mut p, &[0.0, 0.0, 1000.0, 0.0]).unwrap();
        assert_eq!(p[2], 0.0);
        assert_eq!(
            o.set_rate("c", 1.0).unwrap_err().to_string(),
            "group: expected one of a, b, found `c`"
        );
    }

    /// redner's trap: once outside or at the bound, d max(p, 0) / dp = 0 never lets a value go.
    #[test]
    fn a_value_at_its_bound_is_released_when_the_gradient_turns() {
        fn released<O: Optimizer<f64>>(inner: O, map: Parameterisation, start: f64) -> usize {
            let mut o = Constrained::new(inner, one(map)).unwrap();
            let (lo, hi) = map.range::<f64>();
            let mut p = [start];
            for _ in 0..500 {
                o.step(&mut p, &[1.0]).unwrap();
            }
            // Log and sigmoid only tend to their bounds.
            let near = if matches!(map, Parameterisation::Box { .. }) {
                0.0
            } else {
                0.01
            };
            assert!(
                p[0] - lo <= near * (hi - lo),
                "{map:?}: not at the bound, {}",
                p[0]
            );
            (1..)
                .find(|_| {
                    o.step(&mut p, &[-1.0]).unwrap();
                    p[0] > 0.1
                })
                .unwrap_or(0)
        }
        let unit = Parameterisation::bounded(0.0, 1.0).unwrap();
        // From inside, from the bound, and from outside.
        for start in [0.5, 0.0, -2.0] {
            assert!(released(momentum(1, 0.05, 0.0), unit, start) <= 4);
            assert!(released(momentum(1, 0.05, 0.9), unit, start) <= 20);
            assert!(released(Adam::new(1, 0.05).unwrap(), unit, start) <= 20);
        }
        let sigmoid = Parameterisation::sigmoid(0.0, 1.0).unwrap();
        let alpha = Parameterisation::log_within(1e-4, 1.0).unwrap();
        for start in [0.5, 1.0, 1e-4] {
            assert!(released(Adam::new(1, 0.1).unwrap(), sigmoid, start) <= 1000);
            assert!(released(Adam::new(1, 0.1).unwrap(), alpha, start) <= 1000);
        }
    }

    /// The stated reason for not projecting the gradient: at a bound with a noisy gradient that
    /// points outwards on average the value stays, as it should.
    #[test]
    fn noise_does_not_push_a_value_off_its_bound() {
        let box_ = Parameterisation::bounded(0.0, 1.0).unwrap();
        let mut o = Constrained::new(Adam::new(1, 0.01).unwrap(), one(box_)).unwrap();
        let mut p = [0.0f64];
        let mut state = 1u64;
        let mut sum = 0.0;
        for _ in 0..4000 {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            let noise = (state >> 40) as f64 / (1u64 << 24) as f64 * 6.0 - 3.0;
            o.step(&mut p, &[1.0 + noise]).unwrap();
            sum += p[0];
        }
        assert!(sum / 4000.0 < 0.005, "{}", sum / 4000.0);
    }

    #[test]
    fn reparameterised_minimum_is_found() {
        // (p - 0.02)^2 over six orders of magnitude, and (p - 0.7)^2.
        let mut groups = Groups::new(2);
        groups
            .add(
                "alpha",
                0..1,
                Parameterisation::log_within(1e-4, 1.0).unwrap(),
            )
            .unwrap();
        groups
            .add("weight", 1..2, Parameterisation::sigmoid(0.0, 1.0).unwrap())
            .unwrap();
        let rates = Rates::new(2, 0.1).unwrap().with_schedule(Schedule::Cosine {
            steps: 3000,
            floor: 0.0,
        });
        // The gradient falls by six orders of magnitude: a short memory for its square.
        let options = AdamOptions {
            beta2: 0.99,
            epsilon: crate::Epsilon::Absolute(1e-12),
            ..Default::default()
        };
        let adam = Adam::<f64>::with_options(rates.unwrap(), options).unwrap();
        let mut o = Constrained::new(adam, groups).unwrap();
        let mut p = [0.9, 0.001];
        for _ in 0..3000 {
            let g = [2.0 * (p[0] - 0.02), 2.0 * (p[1] - 0.7)];
            o.step(&mut p, &g).unwrap();
            assert!((1e-4..=1.0).contains(&p[0]) && (0.0..=1.0).contains(&p[1]));
        }
        assert_relative_eq!(p[0], 0.02, max_relative = 1e-3);
        assert_relative_eq!(p[1], 0.7, max_relative = 1e-3);
    }

    #[test]
    fn values_changed_by_the_caller_are_honoured_and_resting_ones_keep_their_bits() {
        let mut o = Constrained::new(
            Sgd::<f32>::new(1, 0.5).unwrap(),
            one(Parameterisation::log()),
        )
        .unwrap();
        let mut p = [0.3f32];
        for bits in 0..2000 {
            p[0] = f32::from_bits(0.3f32.to_bits() + bits);
            let before = p;
            o.step(&mut p, &[0.0]).unwrap();
            assert_eq!(p, before);
        }
        p[0] = 7.0;
        o.step(&mut p, &[1e-3]).unwrap();
        assert_relative_eq!(p[0], 7.0 * (-0.0035f32).exp(), max_relative = 1e-6);
    }

    #[test]
    fn steps_below_the_resolution_of_the_value_add_up() {
        // Between 1000 and 1001 single precision has steps of 6e-5; dp/du is at most 1/4.
        let map = Parameterisation::sigmoid(1000.0, 1001.0).unwrap();
        let mut o = Constrained::new(Sgd::<f32>::new(1, 1e-5).unwrap(), one(map)).unwrap();
        let mut p = [1000.5f32];
        for _ in 0..4000 {
            o.step(&mut p, &[-4.0]).unwrap();
        }
        assert_relative_eq!(p[0], 1000.5 + 0.04 / 4.0, epsilon = 1e-4);
    }

    #[test]
    fn a_value_outside_its_box_is_projected_even_without_a_gradient() {
        let map = Parameterisation::bounded(0.0, 1.0).unwrap();
        let mut o = Constrained::new(Sgd::<f32>::new(1, 0.1).unwrap(), one(map)).unwrap();
        let mut p = [-2.0f32];
        o.step(&mut p, &[0.0]).unwrap();
        assert_eq!(p, [0.0]);
    }

    #[test]
    fn errors_name_index_and_group_and_change_nothing() {
        let mut groups = Groups::new(3);
        groups
            .add("red", 0..2, Parameterisation::bounded(0.0, 1.0).unwrap())
            .unwrap();
        groups
            .add(
                "alpha",
                2..3,
                Parameterisation::log_within(1e-4, 1.0).unwrap(),
            )
            .unwrap();
        let mut o = Constrained::new(Adam::<f32>::new(3, 0.1).unwrap(), groups).unwrap();
        let mut p = [0.5f32, 0.6, 0.7];
        o.step(&mut p, &[1.0, -1.0, 2.0]).unwrap();
        let saved = (o.clone(), p);
        for (mut start, grad, message) in [
            (
                p,
                vec![1.0, f32::NAN, 0.0],
                "gradient: expected a finite value, found NaN at index 1 (in `red`)",
            ),
            (
                p,
                vec![0.0, 0.0, f32::NEG_INFINITY],
                "gradient: expected a finite value, found -inf at index 2 (in `alpha`)",
            ),
            (
                [f32::NAN, 0.0, 0.5],
                vec![0.0; 3],
                "params: expected a finite value, found NaN at index 0 (in `red`)",
            ),
            (
                [0.5, 0.5, -0.5],
                vec![0.0; 3],
                "parameter: expected a value in [0.0001, 1.0], found -0.5 at index 2 (in `alpha`)",
            ),
            (p, vec![0.0; 2], "grad: expected 3 entries, found 2"),
        ] {
            let before = start.map(f32::to_bits);
            assert_eq!(o.step(&mut start, &grad).unwrap_err().to_string(), message);
            assert_eq!(start.map(f32::to_bits), before);
            assert_eq!(o, saved.0, "{message}");
        }
    }

    #[test]
    fn clashing_groups_are_errors() {
        let mut groups = Groups::new(10);
        groups.add("a", 2..5, Parameterisation::Identity).unwrap();
        for (name, range, message) in [
            (
                "b",
                4..6,
                "group `b`: expected names and ranges that differ from those of `a`",
            ),
            (
                "a",
                6..7,
                "group `a`: expected names and ranges that differ from those of `a`",
            ),
            (
                "c",
                9..11,
                "range 9..11: expected a non-empty range within 0..10",
            ),
            (
                "empty",
                7..7,
                "range 7..7: expected a non-empty range within 0..10",
            ),
        ] {
            let error = groups
                .add(name, range, Parameterisation::Identity)
                .unwrap_err();
            assert_eq!(error.to_string(), message);
        }
        groups.add("d", 5..10, Parameterisation::Identity).unwrap();
        assert_eq!(groups.group_of(7).unwrap().name, "d");
        assert_eq!(groups.group_of(0), None);
        assert!(Constrained::new(Adam::<f32>::new(9, 0.1).unwrap(), groups).is_err());
    }

    /// A run that goes through JSON in the middle equals one that does not, bit for bit.
    fn resumes<T: Scalar>(name: &str) {
        let options = AdamOptions {
            mask_updates: true,
            ..Default::default()
        };
        let rates = || {
            Rates::new(5, 0.1 / 3.0)
                .unwrap()
                .with_schedule(Schedule::Exponential { decay: 0.999 }.after_warm_up(7))
                .unwrap()
        };
        let inner: AnyOptimizer<T> = match name {
            "adam" => AnyOptimizer::Adam(Adam::with_options(rates(), options).unwrap()),
            _ => {
                let options = SgdOptions {
                    momentum: 0.87,
                    nesterov: true,
                    mask_updates: false,
                };
                AnyOptimizer::Sgd(Sgd::with_options(rates(), options).unwrap())
            }
        };
        let mut groups = Groups::new(5);
        groups
            .add(
                "box",
                0..1,
                Parameterisation::bounded(0.0, 1.0 / 3.0).unwrap(),
            )
            .unwrap();
        groups
            .add(
                "log",
                1..2,
                Parameterisation::log_within(1e-4, 1.0).unwrap(),
            )
            .unwrap();
        groups
            .add(
                "sigmoid",
                2..4,
                Parameterisation::sigmoid(-0.1, 0.9).unwrap(),
            )
            .unwrap();
        let mut o = Constrained::new(inner, groups).unwrap();
        o.set_rate("log", 0.123456789 / 7.0).unwrap();
        let run = |o: &mut Constrained<AnyOptimizer<T>, T>, p: &mut [T; 5], n: usize| {
            for _ in 0..n {
                let mut g = p.map(|p| T::from_f64((3.0 * p.to_f64()).sin() - 0.4));
                g[4] = if o.steps() % 3 == 0 {
                    g[4]
                } else {
                    T::default()
                };
                o.step(p, &g).unwrap();
            }
        };
        let mut p = [0.1, 0.02, 0.3, 0.8, 2.0].map(T::from_f64);
        run(&mut o, &mut p, 13);
        let text = serde_json::to_string(&o).unwrap();
        let mut restored: Constrained<AnyOptimizer<T>, T> = serde_json::from_str(&text).unwrap();
        assert_eq!(restored, o);
        let mut q = p;
        run(&mut o, &mut p, 50);
        run(&mut restored, &mut q, 50);
        assert_eq!(p.map(|x| x.bits()), q.map(|x| x.bits()));
        assert_eq!(
            serde_json::to_string(&o).unwrap(),
            serde_json::to_string(&restored).unwrap()
        );
    }

    #[test]
    fn resume_is_bit_exact() {
        for name in ["adam", "sgd"] {
            resumes::<f32>(name);
            resumes::<f64>(name);
        }
    }

    #[test]
    fn damaged_state_is_an_error() {
        let mut groups = Groups::new(2);
        groups.add("p", 0..1, Parameterisation::log()).unwrap();
        let o = Constrained::new(Adam::<f32>::new(2, 0.25).unwrap(), groups).unwrap();
        let text = serde_json::to_string(&o).unwrap();
        let zeros = "0000000000000000";
        for (from, to) in [
            (r#""beta1":"0.9""#, r#""beta1":"1.9""#),
            (zeros, "00000000"),
            (zeros, "000000007fc00000"),
            (
                r#""root_mean_square":"00000000"#,
                r#""root_mean_square":"bf800000"#,
            ),
            (r#""end":2"#, r#""end":3"#),
            (r#""rate":"0.25""#, r#""rate":"NaN""#),
            (r#""start":0,"end":1"#, r#""start":0,"end":7"#),
            (r#""start":0,"end":1"#, r#""start":1,"end":1"#),
        ] {
            assert!(text.contains(from), "{text}");
            let damaged = text.replace(from, to);
            assert!(
                serde_json::from_str::<Constrained<Adam<f32>, f32>>(&damaged).is_err(),
                "{to}"
            );
        }
    }

    proptest! {
        /// Whatever the numbers: a finite result inside the bounds, or an error and no change.
        #[test]
        fn never_a_panic_nor_a_non_finite_value(
            values in prop::array::uniform5(any::<f32>()),
            gradients in prop::collection::vec(prop::array::uniform5(any::<f32>()), 1..6),
            rate in any::<f64>(),
            which in 0..2usize,
        ) {
            let Ok(rates) = Rates::new(5, rate) else { return Ok(()) };
            let inner = AnyOptimizer::<f32>::new(AnyOptimizer::<f32>::NAMES[which], rates).unwrap();
            let mut groups = Groups::new(5);
            groups.add("box", 0..1, Parameterisation::bounded(0.0, 1.0).unwrap()).unwrap();
            groups.add("log", 1..2, Parameterisation::log()).unwrap();
            groups.add("alpha", 2..3, Parameterisation::log_within(1e-4, 1.0).unwrap()).unwrap();
            groups.add("sigmoid", 3..4, Parameterisation::sigmoid(-1.0, 1.0).unwrap()).unwrap();
            let mut o = Constrained::new(inner, groups).unwrap();
            let mut p = values;
            for g in gradients {
                let before = (p.map(f32::to_bits), o.clone());
                if o.step(&mut p, &g).is_ok() {
                    prop_assert!(p.iter().all(|x| x.is_finite()));
                    prop_assert!((0.0..=1.0).contains(&p[0]) && p[1] > 0.0);
                    prop_assert!((1e-4..=1.0).contains(&p[2]) && (-1.0..=1.0).contains(&p[3]));
                } else {
                    prop_assert_eq!((p.map(f32::to_bits), o.clone()), before);
                }
            }
        }
    }
}
