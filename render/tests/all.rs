//! One program of all integration tests: what they compile of generic code, they compile once.

mod blinn_phong;
mod bsdf;
mod common;
mod composites;
mod coverage;
mod curves;
mod differential;
mod displacement;
mod emitters;
mod finite_element;
mod image_io;
mod interior;
mod keys;
mod mesh_attributes;
mod motion;
mod old_scenes;
mod ply;
mod projectors;
mod save;
mod scales;
mod scene_xml;
mod scenes;
mod serialized;
mod shapes;
mod textures;
