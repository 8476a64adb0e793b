//! What Newton steps need of a field, whichever kind it is.

use crate::evaluate::{field_at, Jet, Scratch};
use crate::mesh::TMesh;

/// A field that is asked for values and gradients at one point after another.
pub trait Field<const D: usize> {
    /// Value and gradient; the Hessian is left zero.
    fn jet(&mut self, x: &[f64; D]) -> Jet<D>;
}

/// A T-spline at points in any order.
pub struct Spline<'a, const D: usize> {
    mesh: &'a TMesh<D>,
    c: &'a [f64],
    scratch: Scratch<D>,
}

impl<'a, const D: usize> Spline<'a, D> {
    pub fn new(mesh: &'a TMesh<D>, c: &'a [f64]) -> Self {
        Self {
            mesh,
            c,
            scratch: Scratch::new(),
        }
    }
}

impl<const D: usize> Field<D> for Spline<'_, D> {
    #[inline]
    fn jet(&mut self, x: &[f64; D]) -> Jet<D> {
        field_at::<D, 1>(self.mesh, &mut self.scratch, self.c, x)
    }
}
