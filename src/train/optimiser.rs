//! Adam and SGD, with a state that can be stored: tch's own cannot.

use tch::{Kind, Tensor, no_grad};

use super::{Optimiser, OptimiserKind, TrainError};

/// Kingma and Ba's defaults.
const BETAS: (f64, f64) = (0.9, 0.999);
const EPSILON: f64 = 1e-8;

/// Moves weights against their gradients.
#[derive(Debug)]
pub(super) struct Stepper {
    settings: Optimiser,
    weights: Vec<(String, Tensor)>,
    /// For each weight: the running means of gradient and squared gradient (Adam), or the velocity (SGD).
    moments: Vec<[Tensor; 2]>,
    /// Steps taken.
    pub steps: i64,
}

impl Stepper {
    pub fn new(settings: Optimiser, weights: Vec<(String, Tensor)>) -> Self {
        let moments = weights.iter().map(|(_, w)| [w.detach().zeros_like(), w.detach().zeros_like()]).collect();
        Self { settings, weights, moments, steps: 0 }
    }

    /// The state, under names.
    pub fn state(&self) -> impl Iterator<Item = (String, &Tensor)> {
        self.weights.iter().zip(&self.moments).flat_map(|((name, _), [first, second])| {
            [(format!("first.{name}"), first), (format!("second.{name}"), second)]
        })
    }

    pub fn forget_gradients(&self) {
        for (_, weight) in &self.weights {
            let mut gradient = weight.grad();
            if gradient.defined() {
                let _ = gradient.zero_();
            }
        }
    }

    /// One step of this width. Says the norm of the gradient before it was clipped.
    pub fn step(&mut self, learning_rate: f64) -> Result<f64, TrainError> {
        self.steps += 1;
        no_grad(|| {
            let gradients: Vec<Tensor> = self.weights.iter().map(|(_, weight)| weight.grad()).collect();
            let mut squares = 0.0;
            if self.settings.clip.is_some() {
                for gradient in gradients.iter().filter(|g| g.defined()) {
                    squares += gradient.f_square()?.f_sum(Kind::Double)?.f_double_value(&[])?;
                }
            }
            let norm = squares.sqrt();
            let shrink = self.settings.clip.map_or(1.0, |most| (most / norm.max(1e-12)).min(1.0));
            for (((_, weight), moments), gradient) in self.weights.iter_mut().zip(&mut self.moments).zip(gradients) {
                if !gradient.defined() {
                    continue; // a layer that had no part in this step
                }
                let gradient = if shrink < 1.0 { gradient.f_mul_scalar(shrink)? } else { gradient };
                match self.settings.kind {
                    OptimiserKind::Adam => adam(&self.settings, weight, moments, &gradient, self.steps, learning_rate)?,
                    OptimiserKind::Sgd => sgd(&self.settings, weight, moments, gradient, learning_rate)?,
                }
            }
            Ok(norm)
        })
    }
}

fn adam(
    settings: &Optimiser,
    weight: &mut Tensor,
    [mean, square]: &mut [Tensor; 2],
    gradient: &Tensor,
    steps: i64,
    learning_rate: f64,
) -> Result<(), TrainError> {
    if settings.weight_decay > 0.0 {
        let _ = weight.f_mul_scalar_(1.0 - learning_rate * settings.weight_decay)?;
    }
    let _ = mean.f_lerp_(gradient, 1.0 - BETAS.0)?;
    let _ = square.f_mul_scalar_(BETAS.1)?.f_addcmul_(&gradient.f_mul_scalar(1.0 - BETAS.1)?, gradient)?;
    // Both means begin at nought and are too small at first.
    let unbias = |beta: f64| 1.0 - beta.powi(i32::try_from(steps).unwrap_or(i32::MAX));
    let spread = square.f_sqrt()?.f_mul_scalar(1.0 / unbias(BETAS.1).sqrt())?.f_add_scalar(EPSILON)?;
    let _ = weight.f_addcdiv_(&mean.f_mul_scalar(-learning_rate / unbias(BETAS.0))?, &spread)?;
    Ok(())
}

fn sgd(
    settings: &Optimiser,
    weight: &mut Tensor,
    [velocity, _]: &mut [Tensor; 2],
    gradient: Tensor,
    learning_rate: f64,
) -> Result<(), TrainError> {
    let gradient = match settings.weight_decay {
        0.0 => gradient,
        decay => gradient.f_add(&weight.f_mul_scalar(decay)?)?,
    };
    let _ = velocity.f_mul_scalar_(settings.momentum)?.f_add_(&gradient)?;
    let _ = weight.f_add_(&velocity.f_mul_scalar(-learning_rate)?)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use tch::{Device, nn::VarStore};

    use super::*;

    /// Steps on `x^2 / 2` from 1, whose gradient is x.
    fn path(settings: Optimiser, steps: usize) -> Vec<f64> {
        let store = VarStore::new(Device::Cpu);
        let x = store.root().var("x", &[1], tch::nn::Init::Const(1.0));
        let rate = settings.learning_rate;
        let mut stepper = Stepper::new(settings, vec![("x".into(), x.shallow_clone())]);
        (0..steps)
            .map(|_| {
                stepper.forget_gradients();
                (x.square().sum(Kind::Float) / 2.0).backward();
                stepper.step(rate).unwrap();
                x.double_value(&[0])
            })
            .collect()
    }

    #[test]
    fn adams_steps_are_as_wide_as_the_rate_wherever_the_gradient_has_one_sign() {
        let x = path(Optimiser { learning_rate: 0.01, ..Optimiser::default() }, 3);
        for (x, expected) in x.into_iter().zip([0.99, 0.98, 0.97]) {
            assert!((x - expected).abs() < 1e-4, "{x} {expected}");
        }
    }

    #[test]
    fn sgd_with_momentum_gathers_speed() {
        let sgd = Optimiser { kind: OptimiserKind::Sgd, learning_rate: 0.1, momentum: 0.5, ..Optimiser::default() };
        // v = 1, x = 0.9; v = 0.5 + 0.9, x = 0.76.
        let x = path(sgd.clone(), 2);
        assert!((x[0] - 0.9).abs() < 1e-6 && (x[1] - 0.76).abs() < 1e-6, "{x:?}");
        // The penalty adds 0.5 x: v = 1.5.
        let decayed = path(Optimiser { weight_decay: 0.5, ..sgd }, 1);
        assert!((decayed[0] - 0.85).abs() < 1e-6, "{decayed:?}");
    }

    #[test]
    fn a_clipped_gradient_keeps_its_direction_and_loses_its_length() {
        let settings =
            Optimiser { kind: OptimiserKind::Sgd, learning_rate: 1.0, clip: Some(0.25), ..Optimiser::default() };
        let x = path(settings, 1);
        assert!((x[0] - 0.75).abs() < 1e-6, "{x:?}");
    }
}
