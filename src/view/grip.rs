//! Particles that the pointer holds, or has moved.

use glam::DVec3;

/// How fast a particle may follow the pointer [m/s]: hardly any hand is faster, and a jump would tear the cloth.
const FASTEST: f64 = 4.0;

/// A particle that is a handle because of the pointer, or a handle of the scene that the pointer has moved. Lengths in edges,
/// z up.
#[derive(Clone, Debug, PartialEq)]
struct Hold {
    particle: usize,
    /// Where it goes in the last frame.
    at: DVec3,
    /// Where the pointer wants it, while it is dragged.
    target: Option<DVec3>,
    /// How far from the place that the scene has for it, if it is a handle of the scene.
    offset: DVec3,
    /// Whether it stays held where it was let go.
    pinned: bool,
}

/// All of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Grip {
    holds: Vec<Hold>,
}

impl Grip {
    /// Takes hold of a particle, which is at `at`. Returns whether it is new among those that are held.
    pub fn take(&mut self, particle: usize, at: DVec3) -> bool {
        match self.holds.iter_mut().find(|hold| hold.particle == particle) {
            Some(hold) => {
                hold.target = Some(at);
                false
            }
            None => {
                let hold = Hold { particle, at, target: Some(at), offset: DVec3::ZERO, pinned: false };
                self.holds.push(hold);
                true
            }
        }
    }

    /// Moves the target of the particle that is dragged.
    pub fn drag(&mut self, to: DVec3) {
        self.holds.iter_mut().filter(|hold| hold.target.is_some()).for_each(|hold| hold.target = Some(to));
    }

    /// Lets go of what is dragged. A handle of the scene keeps its distance from where the scene has it; another particle is
    /// free again unless it is to stay `pinned`.
    pub fn let_go(&mut self, pinned: bool) {
        for hold in self.holds.iter_mut().filter(|hold| hold.target.is_some()) {
            (hold.target, hold.pinned) = (None, pinned || hold.pinned);
        }
    }

    /// Drops what is no longer held: neither dragged, nor pinned, nor one of the scene's `handles`.
    pub fn tidy(&mut self, handles: &[usize]) {
        self.holds.retain(|hold| hold.target.is_some() || hold.pinned || handles.contains(&hold.particle));
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.holds.clear();
    }

    /// Returns the particle that is dragged, and where the pointer wants it.
    pub fn dragged(&self) -> Option<(usize, DVec3)> {
        self.holds.iter().find_map(|hold| hold.target.map(|target| (hold.particle, target)))
    }

    /// Whether it holds particles that are no `handles` of the scene, and are not dragged.
    pub fn has_pinned(&self) -> bool {
        self.holds.iter().any(|hold| hold.pinned)
    }

    /// Lets go of the pinned particles.
    pub fn unpin(&mut self) {
        self.holds.iter_mut().for_each(|hold| hold.pinned = false);
    }

    /// Returns the held particles that are no handles of the scene, in the order in which [`Grip::place`] has them.
    pub fn extra(&self, handles: &[usize]) -> Vec<usize> {
        let extra = self.holds.iter().map(|hold| hold.particle);
        extra.filter(|particle| !handles.contains(particle)).collect()
    }

    /// Returns where the handles go in the next frame, `handles` being those of the scene and `places` where it has them, and
    /// then the others that are held. `edge_m` and `frame_s` are the length of an edge and the time of a frame.
    pub fn place(
        &mut self,
        handles: &[usize],
        places: &[[f32; 3]],
        (edge_m, frame_s): (f64, f64),
    ) -> Vec<[f32; 3]> {
        let most = FASTEST * frame_s / edge_m;
        let mut placed = places.to_vec();
        for hold in &mut self.holds {
            let own = handles.iter().position(|handle| *handle == hold.particle);
            let scene = own.map(|k| DVec3::from(places[k].map(f64::from)));
            match (hold.target, scene) {
                (Some(target), _) => hold.at += (target - hold.at).clamp_length_max(most),
                (None, Some(scene)) => hold.at = scene + hold.offset,
                (None, None) => {}
            }
            if let (Some(_), Some(scene)) = (hold.target, scene) {
                hold.offset = hold.at - scene;
            }
            let at = hold.at.as_vec3().to_array();
            match own {
                Some(k) => placed[k] = at,
                None => placed.push(at),
            }
        }
        placed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNITS: (f64, f64) = (0.03, 1.0 / 60.0);

    #[test]
    fn a_handle_follows_the_pointer_no_faster_than_a_hand_and_keeps_its_distance() {
        let mut grip = Grip::default();
        assert!(grip.take(7, DVec3::ZERO));
        assert!(!grip.take(7, DVec3::ZERO));
        grip.drag(DVec3::X * 10.0);
        let first = grip.place(&[3, 7], &[[5.0; 3], [0.0; 3]], UNITS);
        assert_eq!(first[0], [5.0; 3]);
        assert!((f64::from(first[1][0]) - 4.0 / 60.0 / 0.03).abs() < 1e-6, "{first:?}");
        (0..9).for_each(|_| drop(grip.place(&[3, 7], &[[5.0; 3], [0.0; 3]], UNITS)));
        grip.let_go(false);
        grip.tidy(&[3, 7]);
        assert_eq!(grip.place(&[3, 7], &[[5.0; 3], [0.0, 1.0, 0.0]], UNITS)[1], [10.0, 1.0, 0.0]);
        // The scene lets go of it.
        grip.tidy(&[3]);
        assert_eq!(grip.place(&[3], &[[5.0; 3]], UNITS), [[5.0; 3]]);
    }

    #[test]
    fn other_particles_come_after_the_handles_and_are_free_again_unless_pinned() {
        let mut grip = Grip::default();
        grip.take(9, DVec3::Z);
        assert_eq!((grip.extra(&[1]), grip.dragged()), (vec![9], Some((9, DVec3::Z))));
        assert_eq!(grip.place(&[1], &[[2.0; 3]], UNITS), [[2.0; 3], [0.0, 0.0, 1.0]]);
        grip.let_go(true);
        grip.tidy(&[1]);
        assert!(grip.has_pinned() && grip.extra(&[1]) == [9]);
        grip.unpin();
        grip.tidy(&[1]);
        assert_eq!(grip.extra(&[1]), [0usize; 0]);
    }
}
