//! The reactions of handles on the device.

use crate::Result;
use crate::cloth::modes::{Reactions, SheetConstants};
use crate::cloth::{Grid, Model};
use crate::gpu::{Context, Tensor};

/// Stands for a handle that there isn't.
const NONE: u32 = u32::MAX;

/// What the handles of a batch of cloths do to a step ([`Reactions`]).
#[derive(Clone, Debug)]
pub struct Reacting {
    /// The handles that react, shape [B, room], past the last one `u32::MAX`.
    pub handles: Tensor,
    /// Their fields in space, along both tangents and across, shape [B, room, 4, n].
    pub fields: Tensor,
}

impl Reacting {
    /// Allocates both for cloths of which at most `room` handles react, and which have none until [`Reacting::write`].
    pub fn new(context: &Context, room: usize, (grid, batch): (Grid, usize)) -> Result<Self> {
        let handles = vec![NONE; batch * room];
        Ok(Self {
            handles: Tensor::from_slice(context, "subspace.handles", &[batch, room], &handles)?,
            fields: Tensor::zeros(context, "subspace.reactions", &[batch, room, 4, grid.particles()])?,
        })
    }

    /// Takes the handles and materials of these cloths. Panics if more of them react than there is room for.
    pub fn write(&self, context: &Context, model: &Model) {
        let room = self.handles.shape()[1];
        assert!(Reactions::most(model) <= room, "room for {room} handles");
        let stride = 4 * room * model.grid.particles();
        let mut all = vec![NONE; self.handles.len()];
        for (b, cloth) in model.cloths.iter().enumerate() {
            let Reactions { handles, fields } = Reactions::new(model.grid, cloth, &SheetConstants::FITTED);
            for (to, handle) in all[b * room..].iter_mut().zip(&handles) {
                *to = u32::try_from(*handle).expect("a grid has fewer particles");
            }
            let fields: Vec<f32> = fields.into_iter().map(|v| v as f32).collect();
            self.fields.write_at(context, b * stride, &fields);
        }
        self.handles.write(context, &all);
    }

    /// Returns how many handles of a cloth may react. Panics if they are not those of `batch` cloths of `n` particles.
    pub(super) fn room(&self, batch: usize, n: usize) -> usize {
        let &[cloths, room] = self.handles.shape() else { panic!("handles: {:?}", self.handles.shape()) };
        assert_eq!((cloths, self.fields.shape()), (batch, &[batch, room, 4, n][..]));
        room
    }
}
