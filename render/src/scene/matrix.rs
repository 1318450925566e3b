//! Mitsuba's `to_world` of shapes and sensors: matrices that are read and set, and stand for a translation, a rotation and a
//! scale of ours.

use super::Scene;
use super::movable::{Freedom, Movable, What};
use crate::error::RenderError;
use crate::math::{Transform, each};
use crate::motion::rotation_vector;
use crate::params::{ParamKind, Params};
use crate::shape::{Shape, to_world};

/// What their names end in.
const ENDING: &str = ".to_world";
/// Turns in radians and parts of a size below this are roundings of matrices in single precision.
const NOTHING: f64 = 4.0 * f32::EPSILON as f64;

/// What a matrix places.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Whose {
    Shape(u32),
    Sensor,
}

impl Whose {
    fn what(self, freedom: Freedom) -> What {
        match self {
            Self::Shape(shape) => What::Shape(shape, freedom),
            Self::Sensor => What::Camera(freedom),
        }
    }
}

impl Scene {
    /// Whether a name is that of a matrix ([`Scene::to_world`]).
    pub fn is_matrix(name: &str) -> bool {
        name.ends_with(ENDING) && !Params::is_pattern(name)
    }

    /// The matrix of a shape or of the sensor, `ball.to_world` or `sensor.to_world` as Mitsuba has it, as things are now: from
    /// local coordinates to the world. Centre and radius of a sphere are in it, and both ends and the radius of a cylinder.
    ///
    /// [`Scene::set`] takes 16 numbers, row by row, where what they change is a rotation, a scale that is the same for all
    /// axes and a translation. It makes parameters of those that are not at rest, which stand for the matrix from then
    /// on: `ball.rotation`, `ball.scale` and `ball.translation` have derivatives; the matrix has none.
    ///
    /// # Errors
    /// A name that is none of a matrix, with the closest ones; a shape that has none of its own in a file.
    ///
    /// ```
    /// use render::Scene;
    ///
    /// let text = r#"<scene version="3.0.0"><sensor type="perspective"/>
    ///     <shape type="sphere" id="ball"><point name="center" x="0" y="0" z="5"/></shape></scene>"#;
    /// let (mut scene, _) = Scene::from_xml(text, "".as_ref(), &Default::default())?;
    /// let mut matrix = scene.to_world("ball.to_world")?.to_f32();
    /// matrix[1][3] += 0.5;
    /// scene.set([("ball.to_world", matrix.as_flattened())])?;
    /// assert_eq!(scene.params().get("ball.translation")?, [0.0, 0.5, 0.0]);
    ///
    /// matrix[0][0] = 2.0;
    /// let error = scene.set([("ball.to_world", matrix.as_flattened())]).unwrap_err().to_string();
    /// assert!(error.starts_with("parameter `ball.to_world`: expected a rotation"), "{error}");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn to_world(&self, name: &str) -> Result<Transform, RenderError> {
        let whose = self.owner(name)?;
        let loaded = self.loaded(name, whose)?;
        let moved = match whose {
            Whose::Shape(i) => (self.geometry.placement(i)).map(|p| p.transform(&self.params)),
            Whose::Sensor => Some(self.camera.displacement(&self.params)),
        };
        Ok(moved.map_or(loaded, |by| loaded.then(&by)))
    }

    /// All matrices that there are, with their names.
    pub fn matrices(&self) -> Vec<(String, Transform)> {
        let names = self.infos.iter().map(|i| i.name.as_str());
        let names = names.chain(["sensor"]).map(|of| format!("{of}{ENDING}"));
        names
            .filter_map(|name| self.to_world(&name).ok().map(|matrix| (name, matrix)))
            .collect()
    }

    /// Refuses the name of a matrix as one of a parameter that has derivatives, and names those that have.
    ///
    /// # Errors
    /// It is the name of a matrix.
    pub fn refuse_matrix(&self, name: &str) -> Result<(), RenderError> {
        if !Self::is_matrix(name) {
            return Ok(());
        }
        let whose = self.owner(name)?;
        let all = self.movables();
        let parts: Vec<String> = (Freedom::ALL.iter())
            .filter_map(|&freedom| name_of(&all, whose.what(freedom)))
            .map(|name| format!("`{name}`"))
            .collect();
        Err(RenderError::Matrix {
            name: name.into(),
            reason: format!(
                "a matrix is read and set, and has no derivative; {} have",
                parts.join(", ")
            ),
        })
    }

    /// The ranges that mean a matrix, with their values: those that are parameters already, and those that are not at rest.
    pub(super) fn placed_by(
        &self,
        name: &str,
        matrix: &[f32],
    ) -> Result<Vec<(String, Vec<f32>)>, RenderError> {
        let refuse = |reason: String| RenderError::Matrix {
            name: name.into(),
            reason,
        };
        let whose = self.owner(name)?;
        let rows: Result<[f32; 16], _> = matrix.try_into();
        let rows = rows.map_err(|_| RenderError::ParameterLength {
            name: name.into(),
            expected: 16,
            found: matrix.len(),
        })?;
        let wanted = Transform::from_matrix(&rows.map(f64::from)).ok_or_else(|| {
            let [.., a, b, c, d] = rows;
            refuse(format!(
                "expected a matrix whose last row is 0, 0, 0, 1, found {a}, {b}, {c}, {d}"
            ))
        })?;
        let loaded = self.loaded(name, whose)?;
        let (turn, scale) = loaded.similarity(&wanted).map_err(|found| {
            refuse(format!(
                "expected a rotation, a scale that is the same for all axes and a translation of the matrix in the file, found \
                 {found}"
            ))
        })?;
        let pivot = match whose {
            Whose::Shape(i) => {
                let centroid = || self.geometry.at_rest(i).centroid();
                self.geometry
                    .placement(i)
                    .map_or_else(centroid, |p| p.pivot)
            }
            Whose::Sensor => loaded.translation,
        };
        let by = Transform {
            linear: turn.linear.map(|row| row.map(|x| x * scale)),
            translation: [0.0; 3],
        };
        // Where the pivot goes: x -> by (x - t) + t' for the translations of both matrices.
        let from = each([0, 1, 2], |i: usize| pivot[i] - loaded.translation[i]);
        let (to, size) = (by.vector(from), length(from).max(length(pivot)));
        let shift = each([0, 1, 2], |i: usize| {
            to[i] + wanted.translation[i] - pivot[i]
        });
        let rotation = rotation_vector(turn.linear);
        let values = [
            (
                Freedom::Translation,
                shift.to_vec(),
                length(shift) > NOTHING * size,
            ),
            (
                Freedom::Rotation,
                rotation.to_vec(),
                length(rotation) > NOTHING,
            ),
            (Freedom::Scale, vec![scale], (scale - 1.0).abs() > NOTHING),
        ];
        let all = self.movables();
        let mut out = Vec::new();
        for (freedom, values, is_there) in values {
            let Some(own) = name_of(&all, whose.what(freedom)) else {
                if is_there {
                    let how = match freedom {
                        Freedom::Scale => format!("scale by {scale:.4}"),
                        Freedom::Rotation => "turn".to_owned(),
                        Freedom::Translation => "move".to_owned(),
                    };
                    let key = freedom.key();
                    return Err(refuse(format!(
                        "it would {how}, and there is no {key} here"
                    )));
                }
                continue;
            };
            if is_there {
                out.push((own, values.into_iter().map(|x| x as f32).collect()));
            } else if self.params.find(&own).is_ok() {
                out.push((own, freedom.rest().to_vec()));
            }
        }
        Ok(out)
    }

    fn owner(&self, name: &str) -> Result<Whose, RenderError> {
        let of = name.strip_suffix(ENDING).unwrap_or(name);
        let called = |name: &str| self.infos.iter().position(|i| i.name == name);
        if let Some(shape) = called(of).or_else(|| called(self.params.stands_for(of))) {
            return Ok(Whose::Shape(shape as u32));
        }
        if self.is_sensor(of) {
            return Ok(Whose::Sensor);
        }
        let is_light = |m: &Movable| {
            m.kind == ParamKind::LightPosition
                && m.name.rsplit_once('.').is_some_and(|(own, _)| own == of)
        };
        if let Some(light) = self.movables().iter().find(|m| is_light(m)) {
            return Err(RenderError::Matrix {
                name: name.into(),
                reason: format!("lights have no matrix; `{}` moves this one", light.name),
            });
        }
        let known: Vec<String> = self.matrices().into_iter().map(|(name, _)| name).collect();
        Err(RenderError::unknown_parameter(name, known.iter()))
    }

    /// The matrix in the file.
    fn loaded(&self, name: &str, whose: Whose) -> Result<Transform, RenderError> {
        let Whose::Shape(shape) = whose else {
            return Ok(self.camera.loaded());
        };
        let refuse = |reason: &str| RenderError::Matrix {
            name: name.into(),
            reason: reason.into(),
        };
        let source = self.source.as_ref();
        let source = source
            .ok_or_else(|| refuse("the scene was not read from a file, which has matrices"))?;
        let place = source.places.shapes[shape as usize];
        let place = place
            .ok_or_else(|| refuse("instances place this shape, which has no matrix of its own"))?;
        let node = source.node(place.node);
        let node =
            node.ok_or_else(|| refuse("several shapes are made of this part of the file"))?;
        to_world(node).map_err(|e| refuse(&e.to_string()))
    }
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// What this is called among all that may move.
fn name_of(all: &[Movable], what: What) -> Option<String> {
    all.iter().find(|m| m.what == what).map(|m| m.name.clone())
}
