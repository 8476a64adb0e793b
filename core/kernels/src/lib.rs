//! Kernels of the T-spline level-set toolkit: no Python, no files, no clocks.
//!
//! Everything lives in the unit box `[0, 1]^D`. Tree coordinates are integers in units of `2^-20`, so that cell
//! sides, knots and their comparisons are exact. Results have the same bits for any number of threads: work is cut
//! into fixed chunks and reductions run over them in order.

mod active;
pub mod assembly;
pub mod bspline;
pub mod bulk;
pub mod cholesky;
pub mod conjugate;
pub mod contour;
pub mod dense;
pub mod dissection;
pub mod element;
pub mod error;
pub mod evaluate;
pub mod field;
pub mod front;
pub mod gauss;
pub mod grid;
pub mod hierarchy;
pub mod lattice;
pub mod local;
pub mod mesh;
pub mod mixture;
pub mod net;
mod part;
pub mod patch;
pub mod pattern;
pub mod polynomial;
pub mod project;
pub mod refine;
pub mod relax;
pub mod rows;
pub mod sides;
pub mod sign;
pub mod surface;
pub mod system;
pub mod tree;
pub mod walk;

pub use error::{KernelError, Result};
pub use mesh::TMesh;
pub use system::{Equations, Rates, System};

/// Number of threads that the kernels use.
#[must_use]
pub fn num_threads() -> usize {
    rayon::current_num_threads()
}
