//! All arms with their curves: where tool and links are at a time.

use super::chain::Chain;
use super::curve::{Curve, Peak};
use super::gap::Frame;
use crate::workcell::ArmId;

/// The arms in motion. Holds scratch memory, hence the `&mut self` of queries.
#[derive(Debug)]
pub(super) struct Arms {
    chains: Vec<Chain>,
    curves: Vec<Curve>,
    q: Vec<f64>,
    excursions: Vec<f64>,
    frames: Vec<Frame>,
    /// Segments looked at so far.
    work: u64,
}

/// The most segments that the judge looks at along straight ways and rests.
const MAX_WORK: u64 = 100_000_000;

/// Where an arm's TCP is in the middle of a time interval, and how far it can get from there.
#[derive(Debug, Clone, Copy)]
pub(super) struct ToolMotion {
    /// The TCP frame in the world at the middle.
    pub tcp: Frame,
    /// How far its origin can get from there (m).
    pub shift: f64,
    /// How far it can turn (rad).
    pub turn: f64,
}

impl Arms {
    /// One chain and one curve per arm.
    pub(super) fn new(chains: Vec<Chain>, curves: Vec<Curve>) -> Self {
        Self { chains, curves, q: Vec::new(), excursions: Vec::new(), frames: Vec::new(), work: 0 }
    }

    /// The end of the plan (s).
    pub(super) fn duration(&self) -> f64 {
        self.curves.iter().map(Curve::duration).fold(0.0, f64::max)
    }

    /// Whether more has been looked at than any sensible plan asks for.
    pub(super) fn exhausted(&self) -> bool {
        self.work > MAX_WORK
    }

    /// The greatest joint speed of an arm over `[a, b]`; infinite once [`Self::exhausted`].
    pub(super) fn peak_speed(&mut self, arm: ArmId, a: f64, b: f64) -> Peak {
        if self.exhausted() {
            return Peak { value: f64::INFINITY, t: a };
        }
        let curve = &self.curves[arm.0];
        self.work += curve.segments_between(a, b);
        curve.peak_speed(a, b)
    }

    /// Number of arms.
    pub(super) fn len(&self) -> usize {
        self.chains.len()
    }

    /// An arm's chain.
    pub(super) fn chain(&self, arm: usize) -> &Chain {
        &self.chains[arm]
    }

    /// The TCP frame in the world at `t`.
    pub(super) fn tcp(&mut self, arm: ArmId, t: f64) -> Frame {
        let chain = &self.chains[arm.0];
        self.curves[arm.0].position(t, &mut self.q);
        chain.frames(&self.q, &mut self.frames);
        chain.tcp_frame(&self.frames)
    }

    /// The TCP in the middle of `[a, b]` and its motion over it.
    pub(super) fn tool_motion(&mut self, arm: ArmId, a: f64, b: f64) -> ToolMotion {
        let (chain, curve) = (&self.chains[arm.0], &self.curves[arm.0]);
        self.work += 10 + curve.segments_between(a, b);
        curve.position(0.5 * (a + b), &mut self.q);
        curve.excursions(a, b, &self.q, &mut self.excursions);
        chain.frames(&self.q, &mut self.frames);
        let tcp = chain.tcp_frame(&self.frames);
        let mut bounds = vec![0.0; chain.depth(chain.mount()) + 1];
        chain.motion_bounds(chain.mount(), &tcp.position, 0.0, &self.frames, &self.excursions, &mut bounds);
        let shift = bounds.first().copied().unwrap_or(0.0);
        ToolMotion { tcp, shift, turn: chain.turn_bound(&self.excursions) }
    }

    /// The frames of all nodes of `arm` in the middle of `[a, b]`, and for every joint how far it
    /// gets from its value there; `q` is room to work in. Gives the number of segments that were looked at.
    pub(super) fn place(
        &self,
        arm: usize,
        a: f64,
        b: f64,
        q: &mut Vec<f64>,
        frames: &mut Vec<Frame>,
        excursions: &mut Vec<f64>,
    ) -> u64 {
        let curve = &self.curves[arm];
        curve.position(0.5 * (a + b), q);
        curve.excursions(a, b, q, excursions);
        self.chains[arm].frames(q, frames);
        curve.segments_between(a, b)
    }
}
