//! ad-core
