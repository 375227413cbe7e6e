//! When frames are due.

/// Most frames that one picture may take.
const MOST: usize = 8;
/// Time between pictures \[s\] above which a machine cannot keep up. It then runs slower instead of falling behind, and shows
/// every frame.
const SLOW: f64 = 0.04;
/// Share of a frame's time by which pictures may come early or late and still take one frame each.
const JITTER: f64 = 0.25;

/// Turns the time between pictures into frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clock {
    /// Whether frames are due at all.
    pub playing: bool,
    /// How much faster than life time runs.
    pub speed: f64,
    /// Frames that are due, less than one.
    due: f64,
}

impl Default for Clock {
    fn default() -> Self {
        Self { playing: true, speed: 1.0, due: 0.0 }
    }
}

impl Clock {
    /// Returns how many frames of `frame_s` seconds are due, `elapsed_s` seconds after the last picture.
    pub fn frames(&mut self, elapsed_s: f64, frame_s: f64) -> usize {
        if !self.playing {
            self.due = 0.0;
            return 0;
        }
        let share = elapsed_s / frame_s;
        let share = if (share - 1.0).abs() < JITTER { 1.0 } else { share };
        self.due += self.speed * share;
        let frames = (self.due + 1e-9).floor();
        self.due = (self.due - frames).max(0.0);
        let most = if elapsed_s > SLOW { self.speed.ceil().max(1.0) as usize } else { MOST };
        (frames as usize).min(most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_at_about_the_rate_of_frames_take_one_each() {
        let mut clock = Clock::default();
        let elapsed = [0.0150, 0.0182, 0.0166, 0.0190, 0.0145];
        assert_eq!(elapsed.map(|elapsed| clock.frames(elapsed, 1.0 / 60.0)), [1; 5]);
    }

    #[test]
    fn slow_motion_and_faster_screens_share_frames_out() {
        let mut clock = Clock { speed: 0.25, ..Clock::default() };
        assert_eq!([0; 8].map(|_: u8| clock.frames(1.0 / 60.0, 1.0 / 60.0)), [0, 0, 0, 1, 0, 0, 0, 1]);
        let mut clock = Clock::default();
        assert_eq!([0; 4].map(|_: u8| clock.frames(1.0 / 120.0, 1.0 / 60.0)), [0, 1, 0, 1]);
    }

    #[test]
    fn a_machine_that_cannot_keep_up_does_not_fall_behind() {
        let mut clock = Clock::default();
        assert_eq!(clock.frames(1.0, 1.0 / 60.0), 1);
        assert_eq!(clock.frames(1.0 / 60.0, 1.0 / 60.0), 1);
        // A scene of short frames on a usual screen.
        assert_eq!(clock.frames(1.0 / 60.0, 1.0 / 240.0), 4);
        assert_eq!(clock.frames(1.0 / 60.0, 1e-5), MOST);
        clock.playing = false;
        assert_eq!(clock.frames(1.0, 1.0 / 60.0), 0);
    }
}
