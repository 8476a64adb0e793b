//! Distance of a point from a triangle.

type Vec3 = [f64; 3];

/// A triangle with what its distances need, made once.
#[derive(Debug, Clone)]
pub struct Triangle {
    corner: Vec3,
    ab: Vec3,
    ac: Vec3,
    /// Unit normal; zero where the triangle has no area.
    normal: Vec3,
    /// Whether it has none: then the triangle is its three sides.
    flat: bool,
    /// Products ab.ab, ab.ac, ac.ac.
    gram: Vec3,
    /// A ball that holds the triangle.
    center: Vec3,
    radius: f64,
}

impl Triangle {
    pub fn new(a: Vec3, b: Vec3, c: Vec3) -> Self {
        let (ab, ac) = (minus(b, a), minus(c, a));
        let cross = [
            ab[1] * ac[2] - ab[2] * ac[1],
            ab[2] * ac[0] - ab[0] * ac[2],
            ab[0] * ac[1] - ab[1] * ac[0],
        ];
        let area = dot(cross, cross).sqrt();
        // Below that the cross product is rounding, and a direction from it would be chance.
        let flat = area <= 1e-14 * dot(ab, ab).max(dot(ac, ac));
        let center = std::array::from_fn(|q| (a[q] + b[q] + c[q]) / 3.0);
        let radius = [a, b, c]
            .iter()
            .map(|&p| dot(minus(p, center), minus(p, center)))
            .fold(0.0, f64::max)
            .sqrt();
        Self {
            corner: a,
            ab,
            ac,
            normal: if flat { [0.0; 3] } else { cross.map(|x| x / area) },
            flat,
            gram: [dot(ab, ab), dot(ab, ac), dot(ac, ac)],
            center,
            radius,
        }
    }

    /// Distance of `point` where it is below `best`, else `best`.
    #[inline(always)]
    pub fn nearer(&self, point: Vec3, best: f64) -> f64 {
        let from_center = minus(point, self.center);
        let reach = best + self.radius;
        if dot(from_center, from_center) >= reach * reach {
            return best;
        }
        let p = minus(point, self.corner);
        let height = dot(p, self.normal);
        if height.abs() >= best {
            return best;
        }
        let square = self.square(p, height);
        if square < best * best {
            square.sqrt()
        } else {
            best
        }
    }

    /// Distance of `point`.
    pub fn distance(&self, point: Vec3) -> f64 {
        let p = minus(point, self.corner);
        self.square(p, dot(p, self.normal)).sqrt()
    }

    /// Squared distance of `p`, seen from the first corner, at `height` over the plane: the regions of Ericson,
    /// "Real-time collision detection" (2005), 5.1.5.
    #[inline(always)]
    fn square(&self, p: Vec3, height: f64) -> f64 {
        let [bb, bc, cc] = self.gram;
        let (db, dc) = (dot(self.ab, p), dot(self.ac, p));
        if !self.flat {
            // Twice the signed areas that the foot point cuts off, times twice the triangle's area.
            let (v, w) = (db * cc - dc * bc, dc * bb - db * bc);
            if v >= 0.0 && w >= 0.0 && v + w <= bb * cc - bc * bc {
                return height * height;
            }
        }
        let third = bb - 2.0 * bc + cc;
        let along = |t: f64, of: f64| if of > 0.0 { (t / of).clamp(0.0, 1.0) } else { 0.0 };
        let (s, t, u) = (along(db, bb), along(dc, cc), along(bb - bc + dc - db, third));
        let square = |v: f64, w: f64| {
            let rest = std::array::from_fn(|q| p[q] - v * self.ab[q] - w * self.ac[q]);
            dot(rest, rest)
        };
        square(s, 0.0).min(square(0.0, t)).min(square(1.0 - u, u))
    }
}

#[inline(always)]
pub fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub fn minus(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Least distance over a fine raster of the triangle: above the distance by less than a raster cell's square.
    fn by_raster(corners: [Vec3; 3], point: Vec3) -> f64 {
        let n = 400;
        let mut best = f64::INFINITY;
        for i in 0..=n {
            for j in 0..=n - i {
                let (v, w) = (i as f64 / n as f64, j as f64 / n as f64);
                let foot = std::array::from_fn(|q| {
                    (1.0 - v - w) * corners[0][q] + v * corners[1][q] + w * corners[2][q]
                });
                let d = minus(point, foot);
                best = best.min(dot(d, d).sqrt());
            }
        }
        best
    }

    #[test]
    fn distances_are_those_of_a_raster() {
        let mut seed = 17_u64;
        let mut next = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 11) as f64 / (1_u64 << 53) as f64
        };
        for _ in 0..60 {
            let mut corner = || [next(), next(), next()];
            let (a, b, c) = (corner(), corner(), corner());
            let point = corner().map(|x| 3.0 * x - 1.0);
            let triangle = Triangle::new(a, b, c);
            let (exact, rough) = (triangle.distance(point), by_raster([a, b, c], point));
            assert!(exact <= rough + 1e-12 && rough - exact < 6e-3, "{exact} {rough}");
            assert_eq!(triangle.nearer(point, 9.0).to_bits(), exact.to_bits());
            assert_eq!(
                triangle.nearer(point, 0.5 * exact).to_bits(),
                (0.5 * exact).to_bits()
            );
        }
    }

    #[test]
    fn triangles_without_area_are_their_sides() {
        let flat = Triangle::new([0.0; 3], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0]);
        assert!((flat.distance([2.0, 0.0, 1.5]) - 1.5).abs() < 1e-15);
        assert!((flat.distance([4.0, 1.0, 0.0]) - 2.0_f64.sqrt()).abs() < 1e-15);
        let point = Triangle::new([1.0; 3], [1.0; 3], [1.0; 3]);
        assert!((point.distance([1.0, 3.0, 1.0]) - 2.0).abs() < 1e-15);
    }
}
