//! How long a dispatch would take on a card that is not here.

use super::work::{Latencies, WARP, Work};

/// A GPU, as the model of [`Card::seconds`] sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Card {
    /// Its name.
    pub name: &'static str,
    /// Multiprocessors (compute units, cores), each with workgroup memory of its own.
    pub processors: f64,
    /// Cycles a second.
    pub clock_hz: f64,
    /// Instructions that a processor starts in a cycle, each for 32 lanes.
    pub issues: f64,
    /// Most instructions' worth of lanes (warps) that a processor holds at once.
    pub warps: f64,
    /// Workgroup memory of a processor \[bytes\].
    pub workgroup_memory: f64,
    /// Bytes that a processor exchanges with its workgroup memory in a cycle.
    pub workgroup_bytes: f64,
    /// Bytes that all processors exchange with the second cache in a cycle.
    pub memory_bytes: f64,
    /// Cycles until results may be used.
    pub latencies: Latencies,
    /// Between the end of a dispatch and the begin of the next one, which waits for it \[s\].
    pub gap_s: f64,
}

/// Cards with the figures of their makers and of public measurements, but for the gap and the warps. The gap is chosen between 1.5 and
/// 3 us, as reported for dispatches in a pass that depend on each other. The warps are those that fit with 80 registers an invocation,
/// the mean of this crate's kernels.
pub const CARDS: &[Card] = &[
    Card {
        name: "RTX 4090",
        processors: 128.0,
        clock_hz: 2.52e9,
        issues: 4.0,
        warps: 24.0,
        workgroup_memory: 100e3,
        workgroup_bytes: 128.0,
        memory_bytes: 2000.0,
        latencies: Latencies { memory: 270.0, workgroup: 30.0, arithmetic: 4.0 },
        gap_s: 1.5e-6,
    },
    Card {
        name: "H100",
        processors: 132.0,
        clock_hz: 1.75e9,
        issues: 4.0,
        warps: 24.0,
        workgroup_memory: 228e3,
        workgroup_bytes: 128.0,
        memory_bytes: 3000.0,
        latencies: Latencies { memory: 260.0, workgroup: 30.0, arithmetic: 4.0 },
        gap_s: 1.5e-6,
    },
    Card {
        name: "RX 7900 XTX",
        processors: 96.0,
        clock_hz: 2.4e9,
        issues: 2.0,
        warps: 32.0,
        workgroup_memory: 64e3,
        workgroup_bytes: 128.0,
        memory_bytes: 1500.0,
        latencies: Latencies { memory: 400.0, workgroup: 60.0, arithmetic: 5.0 },
        gap_s: 3e-6,
    },
    Card {
        name: "M2",
        processors: 10.0,
        clock_hz: 1.4e9,
        issues: 4.0,
        warps: 24.0,
        workgroup_memory: 32e3,
        workgroup_bytes: 64.0,
        memory_bytes: 300.0,
        latencies: Latencies { memory: 300.0, workgroup: 40.0, arithmetic: 4.0 },
        gap_s: 3e-6,
    },
];

/// What takes a dispatch longest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Bound {
    /// Waiting for results: loads, barriers, and the chain of instructions of an invocation.
    Latency,
    /// Starting instructions.
    Issue,
    /// Workgroup memory.
    Workgroup,
    /// The second cache.
    Memory,
}

impl Bound {
    /// Returns its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Latency => "latency",
            Self::Issue => "instructions",
            Self::Workgroup => "workgroup memory",
            Self::Memory => "memory",
        }
    }
}

impl Card {
    /// Returns the seconds that a dispatch takes, without the gap before it, and what bounds them: the longest of these, as if the others
    /// hid behind it. The chain of an invocation, as often as workgroups must wait for others to end; the instructions, and the bytes of
    /// workgroup memory, of the processor with the most workgroups; and the bytes of all of them.
    pub fn seconds(&self, work: &Work) -> (f64, Bound) {
        let invocations = f64::from(work.invocations);
        let warps = (invocations / f64::from(WARP)).ceil();
        let groups = work.groups as f64;
        let by_memory = (self.workgroup_memory / (work.workgroup_memory as f64).max(1.0)).floor();
        let at_once = (self.warps / warps).floor().min(by_memory).max(1.0);
        let rounds = (groups / (self.processors * at_once)).ceil();
        let of_busiest = (groups / self.processors).ceil();
        let bounds = [
            (rounds * work.cycles, Bound::Latency),
            (of_busiest * warps * work.instructions / self.issues, Bound::Issue),
            (of_busiest * invocations * work.workgroup_bytes / self.workgroup_bytes, Bound::Workgroup),
            (groups * invocations * work.memory_bytes / self.memory_bytes, Bound::Memory),
        ];
        let (cycles, bound) = bounds.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).expect("four bounds");
        (cycles / self.clock_hz, bound)
    }
}
