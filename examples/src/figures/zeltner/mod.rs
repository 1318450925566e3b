//! [Zeltner 2021], Light path gradients for forward and inverse rendering.
//!
//! Experiments with random numbers in one dimension share [`integration_1d`], those with differential estimators
//! [`taxonomy`]. Those of whole scenes take them from [`super::common_scenes`].

pub mod alg_4_1;
mod differential_normals;
mod estimator_parts;
mod exact_moments;
pub mod fig_1_1;
pub mod fig_2_10;
pub mod fig_2_11;
pub mod fig_2_13;
pub mod fig_2_14;
pub mod fig_2_16;
pub mod fig_2_21;
pub mod fig_2_22;
pub mod fig_2_23;
pub mod fig_2_24;
pub mod fig_2_25;
pub mod fig_2_27;
pub mod fig_2_28;
pub mod fig_2_5_3;
pub mod fig_2_6;
pub mod fig_2_6_ad;
pub mod fig_3_12;
pub mod fig_3_14;
pub mod fig_3_15;
pub mod fig_3_17;
pub mod fig_4_10;
pub mod fig_4_11;
pub mod fig_4_12;
pub mod fig_4_13;
pub mod fig_4_14;
pub mod fig_4_15;
pub mod fig_4_16;
pub mod fig_4_17;
pub mod fig_4_18;
pub mod fig_4_19;
pub mod fig_4_2;
pub mod fig_4_20;
pub mod fig_4_22;
pub mod fig_4_2_1_foot4;
pub mod fig_4_2_2_env;
pub mod fig_4_4;
pub mod fig_4_5;
pub mod fig_4_8;
mod fresnel_angles;
mod glint_scenes;
pub mod integration_1d;
mod microfacet;
mod propagation;
pub mod radiance_split;
mod recovery;
mod specular_scenes;
pub mod tab_4_5_1;
pub mod taxonomy;
mod two_bumps;
