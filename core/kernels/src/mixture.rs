//! Log-densities of mixtures of normal distributions.

use multiversion::multiversion;
use rayon::prelude::*;

/// Pixels that are worked on together: one register holds several of them.
const BLOCK: usize = 64;
/// Pixels of one task.
const CHUNK: usize = 64 * BLOCK;

/// A mixture of normal distributions of `channels` channels; log p of part k is
/// `constants[k] - |whitening[k] x - centres[k]|^2 / 2`, with lower triangular `whitening[k]`.
pub struct Mixture<'a> {
    pub channels: usize,
    pub whitening: &'a [f32],
    pub centres: &'a [f32],
    pub constants: &'a [f32],
}

impl Mixture<'_> {
    /// Logarithm of the density at rows of `channels` values each.
    ///
    /// # Panics
    ///
    /// When the lengths do not fit together.
    pub fn log_density(&self, values: &[f32], density: &mut [f32]) {
        let (parts, channels) = (self.constants.len(), self.channels);
        assert_eq!(self.centres.len(), parts * channels);
        assert_eq!(self.whitening.len(), parts * channels * channels);
        assert_eq!(values.len(), density.len() * channels);
        density
            .par_chunks_mut(CHUNK)
            .enumerate()
            .for_each(|(task, chunk)| {
                let mut planes = vec![[0.0_f32; BLOCK]; channels];
                let mut logs = vec![[0.0_f32; BLOCK]; parts];
                for (piece, block) in chunk.chunks_mut(BLOCK).enumerate() {
                    let first = task * CHUNK + piece * BLOCK;
                    let rows = &values[first * channels..(first + block.len()) * channels];
                    for (pixel, row) in rows.chunks_exact(channels).enumerate() {
                        for (plane, &value) in planes.iter_mut().zip(row) {
                            plane[pixel] = value;
                        }
                    }
                    for (k, log) in logs.iter_mut().enumerate() {
                        let (from, size) = (k * channels, channels * channels);
                        let whitening = &self.whitening[k * size..][..size];
                        part_log(
                            whitening,
                            &self.centres[from..][..channels],
                            self.constants[k],
                            &planes,
                            log,
                        );
                    }
                    let total = log_sum(&logs);
                    block.copy_from_slice(&total[..block.len()]);
                }
            });
    }
}

/// log p of one part.
#[multiversion(targets("x86_64+avx+avx2"))]
fn part_log(
    whitening: &[f32],
    centre: &[f32],
    constant: f32,
    planes: &[[f32; BLOCK]],
    log: &mut [f32; BLOCK],
) {
    let channels = planes.len();
    *log = [constant; BLOCK];
    for i in 0..channels {
        let row = &whitening[i * channels..][..=i];
        let mut away = [-centre[i]; BLOCK];
        for (weight, plane) in row.iter().zip(planes) {
            for (a, v) in away.iter_mut().zip(plane) {
                *a += weight * v;
            }
        }
        for (l, a) in log.iter_mut().zip(&away) {
            *l -= 0.5 * a * a;
        }
    }
}

/// log sum exp over the parts.
#[multiversion(targets("x86_64+avx+avx2"))]
fn log_sum(logs: &[[f32; BLOCK]]) -> [f32; BLOCK] {
    let mut most = logs[0];
    for log in &logs[1..] {
        for (m, &l) in most.iter_mut().zip(log) {
            *m = m.max(l);
        }
    }
    if logs.len() == 1 {
        return most;
    }
    let mut sum = [0.0_f32; BLOCK];
    for log in logs {
        for ((s, &l), &m) in sum.iter_mut().zip(log).zip(&most) {
            *s += exp(l - m);
        }
    }
    for (m, s) in most.iter_mut().zip(&sum) {
        *m += s.ln();
    }
    most
}

/// e^x for x <= 0 to a relative error of 3e-7, without a branch so that loops of it become vector code; 0 below -87.
#[inline(always)]
fn exp(x: f32) -> f32 {
    let x = x.max(-87.0);
    let whole = (x * std::f32::consts::LOG2_E + 0.5).floor();
    // ln 2 in two parts, of which the first times a whole number is exact (Cody and Waite).
    let t = (x - whole * (355.0 / 512.0)) + whole * 2.121_944_4e-4;
    // Taylor series of degree 7 on +-ln 2 / 2.
    let series = 1.0
        + t * (1.0
            + t * (0.5
                + t * (1.0 / 6.0
                    + t * (1.0 / 24.0 + t * (1.0 / 120.0 + t * (1.0 / 720.0 + t * (1.0 / 5040.0)))))));
    // At least -126: a normal number.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let bits = ((whole as i32 + 127) as u32) << 23;
    series * f32::from_bits(bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_is_close_to_the_library() {
        for i in 0..8700_u16 {
            let x = -f32::from(i) * 0.01;
            assert!((exp(x) / x.exp() - 1.0).abs() < 5e-7, "{x}");
        }
    }

    #[test]
    fn mixture_of_two_is_the_definition() {
        let mixture = Mixture {
            channels: 2,
            whitening: &[2.0, 0.0, 1.0, 3.0, 1.0, 0.0, 0.0, 1.0],
            centres: &[0.5, -0.25, 1.0, 2.0],
            constants: &[-1.0, -2.0],
        };
        let values: Vec<f32> = (0..200_u8).map(|i| f32::from(i) * 0.01 - 1.0).collect();
        let mut density = vec![0.0; 100];
        mixture.log_density(&values, &mut density);
        for (row, found) in values.chunks_exact(2).zip(&density) {
            let (x, y) = (f64::from(row[0]), f64::from(row[1]));
            let first = -1.0 - 0.5 * ((2.0 * x - 0.5).powi(2) + (x + 3.0 * y + 0.25).powi(2));
            let second = -2.0 - 0.5 * ((x - 1.0).powi(2) + (y - 2.0).powi(2));
            let expected = (first.exp() + second.exp()).ln();
            assert!((f64::from(*found) - expected).abs() < 1e-5);
        }
    }
}
