//! Python bindings: arrays in, arrays out, nothing else.

// Arguments arrive from Python by value.
#![allow(clippy::needless_pass_by_value)]

#[macro_use]
mod blocks;
mod cloud;
mod convert;
mod hierarchy;
mod mesh;
mod mixture;
mod relax;
mod scan;
mod sparse_field;
mod system;

use pyo3::prelude::*;

/// Compiled kernels of the T-spline level-set toolkit; everything lives in the unit box.
#[pymodule]
mod _core {
    #[pymodule_export]
    use super::blocks::Blocks;
    #[pymodule_export]
    use super::cloud::{locate_cells, num_threads, planes, sides_of};
    #[pymodule_export]
    use super::hierarchy::Hierarchy;
    #[pymodule_export]
    use super::mesh::TMesh;
    #[pymodule_export]
    use super::mixture::mixture_log_density;
    #[pymodule_export]
    use super::relax::{relaxed_classes, relaxed_regions};
    #[pymodule_export]
    use super::scan::scan_convert;
    #[pymodule_export]
    use super::sparse_field::SparseField;
    #[pymodule_export]
    use super::system::System;
}
