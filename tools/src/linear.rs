//! Systems of linear equations.

/// Solves a symmetric positive system, given row by row; `None` if it is not determined.
pub fn cholesky(mut m: Vec<f64>, mut right: Vec<f64>) -> Option<Vec<f64>> {
    let n = right.len();
    for j in 0..n {
        for k in 0..j {
            let factor = m[j * n + k];
            if factor != 0.0 {
                for i in j..n {
                    m[i * n + j] -= factor * m[i * n + k];
                }
            }
        }
        let pivot = m[j * n + j];
        if pivot.is_nan() || pivot <= 1e-12 {
            return None;
        }
        let root = pivot.sqrt();
        for i in j..n {
            m[i * n + j] /= root;
        }
    }
    for i in 0..n {
        let sum: f64 = (0..i).map(|k| m[i * n + k] * right[k]).sum();
        right[i] = (right[i] - sum) / m[i * n + i];
    }
    for i in (0..n).rev() {
        let sum: f64 = (i + 1..n).map(|k| m[k * n + i] * right[k]).sum();
        right[i] = (right[i] - sum) / m[i * n + i];
    }
    Some(right)
}
