//! Adam and SGD, with a state that can be stored: tch's own cannot.

use tch::{Tensor, no_grad};

use super::{Optimiser, OptimiserKind, TrainError};

/// Kingma and Ba's defaults.
const BETAS: (f64, f64) = (0.9, 0.999);
const EPSILON: f64 = 1e-8;

/// Moves weights against their gradients.
///
/// All weights are stored together in one tensor, of which the network's weights are views; so are the moments. A step
/// then takes a dozen operations instead of hundreds, several for each layer.
#[derive(Debug)]
pub(crate) struct Stepper {
    settings: Optimiser,
    /// Adam's.
    epsilon: f64,
    weights: Vec<(String, Tensor)>,
    /// (N), all of them.
    flat: Tensor,
    /// (N) each: the running means of gradient and squared gradient (Adam), or the velocity and nothing (SGD).
    moments: [Tensor; 2],
    /// Views of the moments, one pair for each weight.
    of_weights: Vec<[Tensor; 2]>,
    /// Steps taken.
    pub steps: i64,
}

impl Stepper {
    /// Takes over the memory of the weights, which are f32 and on one device.
    ///
    /// # Errors
    /// [`TrainError::Network`] if libtorch finds no memory.
    pub fn new(settings: Optimiser, weights: Vec<(String, Tensor)>) -> Result<Self, TrainError> {
        no_grad(|| {
            let rows: Vec<Tensor> =
                weights.iter().map(|(_, w)| w.f_detach()?.f_reshape([-1])).collect::<Result<_, _>>()?;
            let flat = Tensor::f_cat(&rows, 0)?;
            let moments = [flat.f_zeros_like()?, flat.f_zeros_like()?];
            let mut of_weights = Vec::with_capacity(weights.len());
            let mut from = 0;
            for (_, weight) in &weights {
                let (size, count) = (weight.size(), weight.numel() as i64);
                let view = |all: &Tensor| all.f_narrow(0, from, count)?.f_view(size.as_slice());
                weight.shallow_clone().f_set_data(&view(&flat)?)?;
                of_weights.push([view(&moments[0])?, view(&moments[1])?]);
                from += count;
            }
            Ok(Self { settings, epsilon: EPSILON, weights, flat, moments, of_weights, steps: 0 })
        })
    }

    /// The same with another epsilon for Adam than 1e-8.
    pub fn with_epsilon(self, epsilon: f64) -> Self {
        Self { epsilon, ..self }
    }

    /// The state, by names.
    pub fn state(&self) -> impl Iterator<Item = (String, &Tensor)> {
        self.weights.iter().zip(&self.of_weights).flat_map(|((name, _), [first, second])| {
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

    /// Takes one step of this width. Returns the norm of the gradient before clipping, if it is clipped at all.
    pub fn step(&mut self, learning_rate: f64) -> Result<Option<f64>, TrainError> {
        let gradients = self.weights.iter().map(|(_, weight)| match weight.grad() {
            gradient if gradient.defined() => Ok(gradient),
            _ => weight.f_detach()?.f_zeros_like(), // a layer that took no part in this step
        });
        let gradients = gradients.collect::<Result<Vec<_>, _>>()?;
        self.step_along(&gradients, learning_rate)
    }

    /// The same along gradients that were computed elsewhere, one for each weight.
    pub fn step_along(&mut self, gradients: &[Tensor], learning_rate: f64) -> Result<Option<f64>, TrainError> {
        self.steps += 1;
        no_grad(|| {
            let rows = gradients.iter().map(|gradient| gradient.f_reshape([-1]));
            let mut gradient = Tensor::f_cat(&rows.collect::<Result<Vec<_>, _>>()?, 0)?; // (N)
            let mut norm = None;
            if let Some(most) = self.settings.clip {
                let length = gradient.f_norm()?.f_double_value(&[])?;
                let _ = gradient.f_mul_scalar_((most / length.max(1e-12)).min(1.0))?;
                norm = Some(length);
            }
            match self.settings.kind {
                OptimiserKind::Adam => self.adam(&gradient, learning_rate)?,
                OptimiserKind::Sgd => self.sgd(&gradient, learning_rate)?,
            }
            Ok(norm)
        })
    }

    fn adam(&mut self, gradient: &Tensor, learning_rate: f64) -> Result<(), TrainError> {
        let [mean, square] = &mut self.moments;
        if self.settings.weight_decay > 0.0 {
            let _ = self.flat.f_mul_scalar_(1.0 - learning_rate * self.settings.weight_decay)?;
        }
        let _ = mean.f_lerp_(gradient, 1.0 - BETAS.0)?;
        let _ = square.f_mul_scalar_(BETAS.1)?.f_addcmul_(&gradient.f_mul_scalar(1.0 - BETAS.1)?, gradient)?;
        // Both means begin at zero and are too small at first.
        let unbias = |beta: f64| 1.0 - beta.powi(i32::try_from(self.steps).unwrap_or(i32::MAX));
        let spread = square.f_sqrt()?.f_mul_scalar_(1.0 / unbias(BETAS.1).sqrt())?.f_add_scalar_(self.epsilon)?;
        let _ = self.flat.f_addcdiv_(&mean.f_mul_scalar(-learning_rate / unbias(BETAS.0))?, &spread)?;
        Ok(())
    }

    fn sgd(&mut self, gradient: &Tensor, learning_rate: f64) -> Result<(), TrainError> {
        let [velocity, _] = &mut self.moments;
        let _ = velocity.f_mul_scalar_(self.settings.momentum)?.f_add_(gradient)?;
        if self.settings.weight_decay > 0.0 {
            let _ = velocity.f_add_(&self.flat.f_mul_scalar(self.settings.weight_decay)?)?;
        }
        let _ = self.flat.f_add_(&velocity.f_mul_scalar(-learning_rate)?)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind, nn::VarStore};

    use super::*;

    /// Steps on `x^2 / 2` from 1, whose gradient is x.
    fn path(settings: Optimiser, steps: usize) -> Vec<f64> {
        let store = VarStore::new(Device::Cpu);
        let x = store.root().var("x", &[1], tch::nn::Init::Const(1.0));
        let rate = settings.learning_rate;
        let mut stepper = Stepper::new(settings, vec![("x".into(), x.shallow_clone())]).unwrap();
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

    /// Three steps on a made-up loss over two weights, by `step` after each backward pass.
    fn weights_after(mut step: impl FnMut(&VarStore) -> Box<dyn FnMut(&Tensor)>) -> Vec<f64> {
        let store = VarStore::new(Device::Cpu);
        let weight = store.root().var("a", &[3, 2], tch::nn::Init::Const(0.5));
        let bias = store.root().var("b", &[2], tch::nn::Init::Const(-0.25));
        let mut step = step(&store);
        let x = Tensor::from_slice(&[1.0f32, -2.0, 0.5, 3.0, 0.25, -1.0]).view([2, 3]); // (2, 3)
        for _ in 0..3 {
            step(&(x.matmul(&weight) + &bias).sin().square().sum(Kind::Float));
        }
        [weight, bias].iter().flat_map(|tensor| Vec::<f64>::try_from(tensor.detach().flatten(0, -1)).unwrap()).collect()
    }

    #[test]
    fn weights_of_several_shapes_go_the_way_that_libtorchs_own_optimisers_go() {
        use tch::nn::{AdamW, OptimizerConfig, Sgd};
        let (rate, decay, clip) = (0.05, 0.1, 0.7);
        let adamw = AdamW { wd: decay, ..AdamW::default() };
        let sgd = Sgd { momentum: 0.9, wd: decay, ..Sgd::default() };
        for kind in [OptimiserKind::Adam, OptimiserKind::Sgd] {
            let settings = Optimiser { kind, weight_decay: decay, clip: Some(clip), ..Optimiser::default() };
            let ours = weights_after(|store| {
                let weights = ["a", "b"].map(|name| (name.to_owned(), store.variables()[name].shallow_clone()));
                let mut stepper = Stepper::new(settings.clone(), weights.into()).unwrap();
                Box::new(move |loss| {
                    stepper.forget_gradients();
                    loss.backward();
                    stepper.step(rate).unwrap();
                })
            });
            let theirs = weights_after(|store| {
                let mut optimizer = match kind {
                    OptimiserKind::Adam => adamw.build(store, rate).unwrap(),
                    OptimiserKind::Sgd => sgd.build(store, rate).unwrap(),
                };
                Box::new(move |loss| optimizer.backward_step_clip_norm(loss, clip))
            });
            assert!(ours.iter().zip(&theirs).all(|(a, b)| (a - b).abs() < 1e-5), "{kind:?}: {ours:?} {theirs:?}");
            assert!(ours.iter().any(|x| (x.abs() - 0.5).abs() > 0.05), "it moved: {ours:?}");
        }
    }
}
