//! Where the nodes of a grid lie.

use std::ops::Range;

use crate::error::{KernelError, Result};

/// What coordinates may be off by rounding, in spacings.
const SLACK: f64 = 1e-6;

/// A box of nodes `origin + spacing * index`.
#[derive(Debug, Clone, Copy)]
pub struct Nodes {
    pub shape: [usize; 3],
    pub origin: [f64; 3],
    pub spacing: [f64; 3],
}

impl Nodes {
    pub fn new(shape: [usize; 3], origin: [f64; 3], spacing: [f64; 3]) -> Result<Self> {
        if spacing.iter().any(|&h| !h.is_finite() || h <= 0.0) || origin.iter().any(|x| !x.is_finite()) {
            return Err(KernelError::Invalid(format!(
                "grid: found origin {origin:?} and spacing {spacing:?}, accepted are finite numbers and positive lengths"
            )));
        }
        Ok(Self {
            shape,
            origin,
            spacing,
        })
    }

    #[inline(always)]
    pub fn coordinate(&self, axis: usize, index: usize) -> f64 {
        self.origin[axis] + self.spacing[axis] * index as f64
    }

    #[inline(always)]
    pub fn point(&self, node: [usize; 3]) -> [f64; 3] {
        std::array::from_fn(|q| self.coordinate(q, node[q]))
    }

    /// Indices of all nodes between two coordinates, and of such as rounding may have lost.
    pub fn between(&self, axis: usize, low: f64, high: f64) -> Range<usize> {
        let n = self.shape[axis] as f64;
        let index = |x: f64| (x - self.origin[axis]) / self.spacing[axis];
        let first = (index(low) - SLACK).ceil().clamp(0.0, n);
        let last = (index(high) + SLACK).floor().clamp(-1.0, n - 1.0);
        first as usize..(last + 1.0) as usize
    }

    /// The first node that is not below a coordinate; the number of nodes if none is.
    pub fn above(&self, axis: usize, x: f64) -> usize {
        let index = ((x - self.origin[axis]) / self.spacing[axis]).ceil();
        index.clamp(0.0, self.shape[axis] as f64) as usize
    }
}
