//! What the browser reports later: the end of a frame's work, errors of the device, and its loss.

use fnopt::wgpu;
use std::sync::{Arc, Mutex};

/// Why the page cannot go on, if it cannot.
#[derive(Clone, Debug)]
pub struct Fault {
    /// `lost`, `device`, `non-finite` or `error`.
    pub kind: &'static str,
    pub text: String,
}

#[derive(Default)]
struct Inner {
    fault: Option<Fault>,
    /// When the device finished last, and how long it took \[ms\].
    finished: f64,
    took: Option<f64>,
}

/// Shared with the callbacks of the device.
#[derive(Clone, Default)]
pub struct Notices(Arc<Mutex<Inner>>);

/// Returns the time since the page began \[ms\].
fn now() -> f64 {
    web_sys::window().and_then(|window| window.performance()).map_or(0.0, |clock| clock.now())
}

impl Notices {
    /// Returns the notices of a device.
    pub fn of(device: &wgpu::Device) -> Self {
        let notices = Self::default();
        let (lost, wrong) = (notices.clone(), notices.clone());
        device.set_device_lost_callback(move |_, why| {
            let text = format!("the browser took it away ({})", why.trim_end_matches('.'));
            lost.fault("lost", &text);
        });
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            wrong.fault("device", &error.to_string())
        }));
        notices
    }

    fn with<T>(&self, act: impl FnOnce(&mut Inner) -> T) -> T {
        act(&mut self.0.lock().unwrap_or_else(|poisoned| poisoned.into_inner()))
    }

    /// Notes a fault, unless there is one already: the first is the cause of those after it. Only the loss of the device
    /// outweighs it.
    pub fn fault(&self, kind: &'static str, text: &str) {
        self.with(|inner| {
            if inner.fault.is_none() || kind == "lost" {
                inner.fault = Some(Fault { kind, text: text.to_owned() });
            }
        });
    }

    /// Returns the fault.
    pub fn current(&self) -> Option<Fault> {
        self.with(|inner| inner.fault.clone())
    }

    /// Forgets the fault, unless it is the loss of the device.
    pub fn forgive(&self) {
        self.with(|inner| inner.fault = inner.fault.take().filter(|fault| fault.kind == "lost"));
    }

    /// Times what was just submitted: from its submission, or the end of what was submitted before, to its end.
    pub fn time(&self, queue: &wgpu::Queue) {
        let (begun, notices) = (now(), self.clone());
        queue.on_submitted_work_done(move || {
            let ended = now();
            notices.with(|inner| {
                inner.took = Some(ended - inner.finished.max(begun));
                inner.finished = ended;
            });
        });
    }

    /// Returns how long the device took for the last frame \[ms\].
    pub fn took(&self) -> Option<f64> {
        self.with(|inner| inner.took)
    }
}
