//! Fields on grids: node values in blocks of eight an axis, kept near the zero set only where the grid is large.

pub mod blocks;
pub mod interpolant;

pub use blocks::{Blocks, Neighbor};
pub use interpolant::Interpolant;
