//! Fields on grids: node values in blocks of eight an axis, kept near the zero set only where the grid is large.

pub mod blocks;
mod cells;
mod foot;
pub mod interpolant;
pub mod loops;
mod march;
pub mod redistance;
mod region;
pub mod surface;

pub use blocks::{Blocks, Neighbor};
pub use interpolant::Interpolant;
