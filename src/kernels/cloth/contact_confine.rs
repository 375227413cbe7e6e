//! Host side of `shaders/cloth/contact_confine.wgsl`.

use super::Trial;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::optim::directions;
use crate::kernels::{pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "contact_confine",
    wgsl: include_str!("../../../shaders/cloth/contact_confine.wgsl"),
    appended: &[terms::CONTACT, pieces::DISPLACED],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    first_step: u32,
    first_field: u32,
}

/// Moves particles out of bodies after a step.
#[derive(Clone, Debug)]
pub struct ContactConfine {
    /// Without a last step, with one among directions, and with one in the hidden state, too.
    kernels: [Kernel; 3],
    /// Bound where there is no last step, and where there is none in a hidden state.
    nothing: [Tensor; 2],
}

impl ContactConfine {
    /// Builds the kernels for so many contacts of a particle.
    pub fn new(context: &Context, slots: usize) -> Result<Self> {
        let kernel = |steps: f64, remembers: f64| {
            let constants = [("SLOTS", slots as f64), ("STEPS", steps), ("REMEMBERS", remembers)];
            Kernel::new(context, &SOURCE, 0, &constants)
        };
        let nothing = || Tensor::zeros(context, "no last step", &[1]);
        let nothing = [nothing()?, nothing()?];
        Ok(Self { kernels: [kernel(0.0, 0.0)?, kernel(1.0, 0.0)?, kernel(1.0, 1.0)?], nothing })
    }

    /// Moves particles that `iterate.a` leads too near to a body, by the `contacts` [B, slots n, 12], out of it. With
    /// `directions`, also changes the last step among them and in the hidden state, if there is one.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        trial: Trial<'_>,
        contacts: &Tensor,
        directions: Option<&Tensor>,
    ) {
        let (grid, batch, iterate) = (trial.grid, trial.batch(), trial.iterate);
        let n = grid.particles();
        let (fields, hidden) = &iterate.fields();
        let first_step =
            directions.map_or(0, |directions| directions::LAST_STEP * directions::slot(directions, iterate));
        let hidden = hidden.filter(|_| directions.is_some());
        let params = Params {
            particles: size(n),
            first_step: size(first_step),
            first_field: size(hidden.map_or(0, |first| first + 3 * batch * n)),
        };
        let kernel = match (directions, hidden) {
            (None, _) => &self.kernels[0],
            (Some(_), None) => &self.kernels[1],
            (Some(_), Some(_)) => &self.kernels[2],
        };
        let (given, ..) = &iterate.given();
        let [step, field] = &self.nothing;
        let fields = if hidden.is_some() { fields } else { field };
        let tensors = [contacts, given, &iterate.a, directions.unwrap_or(step), fields];
        schedule.dispatch(kernel, &params, &tensors, kernel.spread(n, batch));
    }
}
