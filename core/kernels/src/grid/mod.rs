//! Fields on grids: node values in blocks of eight an axis, kept near the zero set only where the grid is large.

pub mod blocks;
mod cells;
mod foot;
pub mod interpolant;
pub mod loops;
mod march;
pub mod nodes;
pub mod redistance;
mod region;
pub mod scan;
mod screen;
pub mod surface;
pub mod triangle;
pub mod windings;

pub use blocks::{Blocks, Neighbor};
pub use interpolant::Interpolant;
pub use nodes::Nodes;
