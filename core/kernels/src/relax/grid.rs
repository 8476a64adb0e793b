//! Rows of an image or volume, and their neighbours.

/// A grid of pixels in rows along the last axis.
#[derive(Debug, Clone, Copy)]
pub struct Grid<const D: usize> {
    pub shape: [usize; D],
    /// One over the spacing, an axis.
    pub inverse: [f32; D],
}

impl<const D: usize> Grid<D> {
    pub fn cols(&self) -> usize {
        self.shape[D - 1]
    }

    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Rows from one to the next along a leading axis.
    #[inline(always)]
    fn stride(&self, axis: usize) -> usize {
        self.shape[axis + 1..D - 1].iter().product()
    }

    /// The row before along a leading axis.
    #[inline(always)]
    pub fn before(&self, row: usize, axis: usize) -> Option<usize> {
        let stride = self.stride(axis);
        (row / stride % self.shape[axis] > 0).then(|| row - stride)
    }

    /// The row after along a leading axis.
    #[inline(always)]
    pub fn after(&self, row: usize, axis: usize) -> Option<usize> {
        let stride = self.stride(axis);
        (row / stride % self.shape[axis] + 1 < self.shape[axis]).then(|| row + stride)
    }

    /// Rows of a share of the work: the same on any number of threads.
    pub fn chunk(&self) -> usize {
        (PIXELS / self.cols()).max(1)
    }

    /// The grid of half as many pixels an axis.
    pub fn half(&self) -> Self {
        Self {
            shape: self.shape.map(|n| n.div_ceil(2)),
            inverse: self.inverse.map(|i| i / 2.0),
        }
    }
}

/// Pixels of a share of the work.
const PIXELS: usize = 16_384;
