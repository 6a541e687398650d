//! Least squares over a drive and its road at once.
//!
//! The unknowns are the stands of a drive's pictures, each of which knows its neighbours alone, and the road's free
//! control points, which many pictures know. The stands are eliminated one after the other, the small dense system of
//! the road is solved by Cholesky's method, and the stands follow from it (the Schur complement, as in bundle
//! adjustment: Triggs et al., Bundle Adjustment - A Modern Synthesis, 2000, section 6).

use lapwing_tools::{course::STAND, linear::cholesky};

type Block = [[f64; STAND]; STAND];

/// Normal equations that grow by residuals.
#[derive(Debug)]
pub struct Equations {
    stands: usize,
    road: usize,
    diagonal: Vec<Block>,
    /// From each stand to the next.
    links: Vec<Block>,
    /// From each stand to the road: `STAND` rows of `road` numbers.
    across: Vec<f64>,
    dense: Vec<f64>,
    right: Vec<f64>,
    right_road: Vec<f64>,
}

/// One residual's derivatives: by numbers of one or two neighbouring stands, and by the road's.
#[derive(Debug, Clone, Default)]
pub struct Slope {
    /// The first stand, and its derivatives.
    pub stand: Option<(usize, [f64; STAND])>,
    /// The derivatives by the next stand.
    pub next: Option<[f64; STAND]>,
    /// Derivatives by the road's numbers.
    pub road: Vec<(usize, f64)>,
}

impl Equations {
    /// Without any residual.
    pub fn new(stands: usize, road: usize) -> Self {
        Self {
            stands,
            road,
            diagonal: vec![[[0.0; STAND]; STAND]; stands],
            links: vec![[[0.0; STAND]; STAND]; stands],
            across: vec![0.0; stands * STAND * road],
            dense: vec![0.0; road * road],
            right: vec![0.0; stands * STAND],
            right_road: vec![0.0; road],
        }
    }

    /// Adds a residual with its weight (one over its variance).
    pub fn add(&mut self, residual: f64, weight: f64, slope: &Slope) {
        for &(k, a) in &slope.road {
            self.right_road[k] -= weight * a * residual;
            for &(l, b) in &slope.road {
                self.dense[k * self.road + l] += weight * a * b;
            }
        }
        let Some((i, here)) = slope.stand else { return };
        let rows = [Some((i, here)), slope.next.map(|next| (i + 1, next))];
        for (i, row) in rows.into_iter().flatten() {
            for a in 0..STAND {
                self.right[i * STAND + a] -= weight * row[a] * residual;
                for b in 0..STAND {
                    self.diagonal[i][a][b] += weight * row[a] * row[b];
                }
                for &(k, c) in &slope.road {
                    self.across[(i * STAND + a) * self.road + k] += weight * row[a] * c;
                }
            }
        }
        if let Some(next) = slope.next {
            for (row, a) in self.links[i].iter_mut().zip(here) {
                for (value, b) in row.iter_mut().zip(next) {
                    *value += weight * a * b;
                }
            }
        }
    }

    /// The steps of all stands and of the road that make the sum of squares least; `None` if that is not determined.
    pub fn solve(mut self) -> Option<(Vec<[f64; STAND]>, Vec<f64>)> {
        let road = self.road;
        let mut inverses = Vec::with_capacity(self.stands);
        for i in 0..self.stands {
            let inverse = inverted(&self.diagonal[i])?;
            let (here, after) = self.across.split_at_mut((i + 1) * STAND * road);
            let here = &here[i * STAND * road..];
            // What it says of the road far away comes from its neighbours alone, and fades.
            let loudest = here[..STAND * road].iter().fold(0.0_f64, |most, value| most.max(value.abs()));
            let used: Vec<usize> =
                (0..road).filter(|k| (0..STAND).any(|a| here[a * road + k].abs() > 1e-7 * loudest)).collect();
            if i + 1 < self.stands {
                // The next stand's equations less what this one says of it.
                let link = self.links[i];
                // The link, transposed, times the inverse.
                let product = |a: usize, b: usize| (0..STAND).map(|c| link[c][a] * inverse[c][b]).sum();
                let carry: Block = std::array::from_fn(|a| std::array::from_fn(|b| product(a, b)));
                for a in 0..STAND {
                    for (b, value) in self.diagonal[i + 1][a].iter_mut().enumerate() {
                        *value -= (0..STAND).map(|c| carry[a][c] * link[c][b]).sum::<f64>();
                    }
                    self.right[(i + 1) * STAND + a] -=
                        (0..STAND).map(|c| carry[a][c] * self.right[i * STAND + c]).sum::<f64>();
                    for &k in &used {
                        after[a * road + k] -= (0..STAND).map(|c| carry[a][c] * here[c * road + k]).sum::<f64>();
                    }
                }
            }
            // The road's equations less what this stand says of it.
            let mut turned = vec![[0.0; STAND]; used.len()];
            for (turned, &k) in turned.iter_mut().zip(&used) {
                for a in 0..STAND {
                    turned[a] = (0..STAND).map(|c| inverse[a][c] * here[c * road + k]).sum();
                }
            }
            let right: [f64; STAND] = std::array::from_fn(|a| self.right[i * STAND + a]);
            for (turned, &k) in turned.iter().zip(&used) {
                self.right_road[k] -= (0..STAND).map(|a| turned[a] * right[a]).sum::<f64>();
                for &l in &used {
                    self.dense[k * road + l] -= (0..STAND).map(|a| turned[a] * here[a * road + l]).sum::<f64>();
                }
            }
            inverses.push(inverse);
        }
        let steps = cholesky(self.dense, self.right_road)?;
        let mut stands = vec![[0.0; STAND]; self.stands];
        for i in (0..self.stands).rev() {
            let mut right: [f64; STAND] = std::array::from_fn(|a| self.right[i * STAND + a]);
            for (a, right) in right.iter_mut().enumerate() {
                let row = &self.across[(i * STAND + a) * road..(i * STAND + a + 1) * road];
                *right -= row.iter().zip(&steps).map(|(a, b)| a * b).sum::<f64>();
                if let Some(next) = stands.get(i + 1) {
                    *right -= (0..STAND).map(|b| self.links[i][a][b] * next[b]).sum::<f64>();
                }
            }
            stands[i] = std::array::from_fn(|a| (0..STAND).map(|b| inverses[i][a][b] * right[b]).sum());
        }
        Some((stands, steps))
    }
}

fn inverted(block: &Block) -> Option<Block> {
    let mut m = *block;
    let mut out = [[0.0; STAND]; STAND];
    for (i, row) in out.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    for i in 0..STAND {
        let pivot = m[i][i];
        if pivot.is_nan() || pivot <= 1e-12 {
            return None;
        }
        for k in 0..STAND {
            m[i][k] /= pivot;
            out[i][k] /= pivot;
        }
        for j in (0..STAND).filter(|&j| j != i) {
            let factor = m[j][i];
            for k in 0..STAND {
                m[j][k] -= factor * m[i][k];
                out[j][k] -= factor * out[i][k];
            }
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stands_and_road_are_found_that_meet_every_residual() {
        // Each residual is linear: what it would be at the solution is zero.
        let (stands, road) = (4, 3);
        let stand_at = |i: usize, a: usize| (i * 7 + a * 3) as f64 % 5.0 - 2.0;
        let road_at = |k: usize| k as f64 - 0.5;
        let mut equations = Equations::new(stands, road);
        for n in 0..120 {
            let i = n % stands;
            let part = |k: usize| ((n * 13 + k * 29) % 17) as f64 / 8.0 - 1.0;
            let here: [f64; STAND] = std::array::from_fn(part);
            let next = (i + 1 < stands).then(|| std::array::from_fn(|a| part(a + 5)));
            let along: Vec<(usize, f64)> = (0..road).map(|k| (k, part(k + 10))).collect();
            let mut value: f64 = (0..STAND).map(|a| here[a] * stand_at(i, a)).sum();
            value += next.map_or(0.0, |next: [f64; STAND]| (0..STAND).map(|a| next[a] * stand_at(i + 1, a)).sum());
            value += along.iter().map(|&(k, by)| by * road_at(k)).sum::<f64>();
            equations.add(-value, 1.0 + part(20).abs(), &Slope { stand: Some((i, here)), next, road: along });
        }
        let (found, along) = equations.solve().unwrap();
        for (i, stand) in found.iter().enumerate() {
            for (a, value) in stand.iter().enumerate() {
                assert!((value - stand_at(i, a)).abs() < 1e-6, "{found:?}");
            }
        }
        assert!((0..road).all(|k| (along[k] - road_at(k)).abs() < 1e-6), "{along:?}");
    }

    #[test]
    fn what_no_residual_determines_is_not_solved() {
        assert!(Equations::new(1, 1).solve().is_none());
    }
}
