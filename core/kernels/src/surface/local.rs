//! A T-spline in space at points that come element by element.

use crate::evaluate::Jet;
use crate::field::Field;
use crate::mesh::TMesh;
use crate::polynomial::Quotient;

/// The field with the element of the last point at hand.
pub struct Local<'a> {
    mesh: &'a TMesh<3>,
    c: &'a [f64],
    quotient: Quotient<3>,
    low: [f64; 3],
    high: [f64; 3],
}

impl<'a> Local<'a> {
    pub fn new(mesh: &'a TMesh<3>, c: &'a [f64]) -> Self {
        Self {
            mesh,
            c,
            quotient: Quotient::new(),
            low: [1.0; 3],
            high: [0.0; 3],
        }
    }
}

impl Field<3> for Local<'_> {
    #[inline(always)]
    fn jet(&mut self, x: &[f64; 3]) -> Jet<3> {
        if !(0..3).all(|a| self.low[a] <= x[a] && x[a] <= self.high[a]) {
            let elements = self.mesh.elements();
            let Some(e) = elements.locate(self.mesh.tree(), x) else {
                return Jet::OUTSIDE;
            };
            let (corner, side) = elements.frame(e);
            self.low = corner;
            self.high = std::array::from_fn(|a| corner[a] + side[a]);
            self.quotient.load(elements, e, self.c);
        }
        self.quotient.at::<1>(x)
    }
}
