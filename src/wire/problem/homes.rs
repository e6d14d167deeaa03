//! Homes: which of them must be good, and what stands in for one that need not be, and is not.
//!
//! An arm is at home where it starts there, or where `return_home` asks for it. Elsewhere home is no more than where an idle
//! arm is well kept: the planner needs some configuration that the arm can be in, and any such will do.

use std::collections::BTreeSet;

use serde_json::Value;

use super::context::Context;
use super::placement::ArmStart;
use crate::kinematics::{Config, JointLimits};
use crate::wire::digest::sha256;
use crate::wire::fault::FaultCode;
use crate::wire::json::child;
use crate::wire::reader::Node;
use crate::workcell::Arm;

/// By arm, the joints that its `home` gives; `None` for an arm without `home`.
#[derive(Debug, Clone, Default)]
pub struct StatedHomes(Vec<Option<BTreeSet<String>>>);

impl StatedHomes {
    /// What the elements of `workcell.arms` say.
    pub fn of(arms: Option<&Node<'_>>) -> Self {
        let joints = |arm: &Value| {
            let home = arm.get("home")?;
            Some(home.as_object().map(|home| home.keys().cloned().collect()).unwrap_or_default())
        };
        let elements = arms.and_then(|node| node.value.as_array());
        Self(elements.map(|list| list.iter().map(joints).collect()).unwrap_or_default())
    }

    /// Whether the arm has `home`.
    fn is_there(&self, arm: usize) -> bool {
        self.0.get(arm).is_some_and(Option::is_some)
    }

    /// Whether the arm's `home` gives the joint.
    fn gives(&self, arm: usize, joint: &str) -> bool {
        self.0.get(arm).and_then(Option::as_ref).is_some_and(|joints| joints.contains(joint))
    }

    /// JSON pointer to what decides an arm's home.
    pub fn pointer(&self, arm: usize) -> String {
        let home = if self.is_there(arm) { "/home" } else { "" };
        format!("/workcell/arms/{arm}{home}")
    }

    /// JSON pointer to what decides where a joint is at home.
    fn joint_pointer(&self, arm: usize, joint: &str) -> String {
        let home = self.pointer(arm);
        if self.gives(arm, joint) { child(&home, joint) } else { home }
    }
}

/// Brings homes within the limits of their joints. Where an arm has to be at home, a value outside is a fault, and the arm
/// counts as not read; elsewhere it is warned of, and a home inside stands in for it, which depends on nothing but the
/// workcell. Around a bare workcell arms start at home, but only what `home` gives has to be right.
///
/// Returns, by arm, whether where it starts is assumed, in whole or in part, and nobody's statement.
pub fn settle(
    arms: &mut [Option<Arm>],
    starts: &mut [Option<ArmStart>],
    stated: &StatedHomes,
    return_home: bool,
    context: &mut Context<'_>,
) -> Vec<bool> {
    let mut assumed = Vec::with_capacity(arms.len());
    for (index, (slot, start)) in arms.iter_mut().zip(starts).enumerate() {
        let before = context.faults.count();
        let is_good = match slot {
            Some(arm) => settle_arm(index, arm, start, stated, return_home, context),
            None => true,
        };
        if context.faults.count() > before {
            (*slot, *start) = (None, None);
        }
        let is_whole = slot
            .as_ref()
            .is_some_and(|arm| arm.model.joints.iter().all(|joint| stated.gives(index, &joint.name)));
        assumed.push(context.bare && !(is_good && is_whole));
    }
    assumed
}

/// Brings the home of one arm within the limits; whether it was there.
fn settle_arm(
    index: usize,
    arm: &mut Arm,
    start: &mut Option<ArmStart>,
    stated: &StatedHomes,
    return_home: bool,
    context: &mut Context<'_>,
) -> bool {
    let given: Vec<bool> = arm.model.joints.iter().map(|joint| stated.gives(index, &joint.name)).collect();
    let (mut is_good, mut lacks_any) = (true, false);
    for (place, (joint, is_given)) in arm.model.joints.iter().zip(&given).enumerate() {
        let (Some(limit), Some(value)) = (arm.limits.get(place), arm.home.get(place)) else { continue };
        if (limit.lower..=limit.upper).contains(value) {
            continue;
        }
        is_good = false;
        lacks_any |= !is_given;
        // What `initial_joints` gives is within the limits: a start outside has its value from home.
        let at_start = start.as_ref().and_then(|(config, _)| config.get(place));
        let has_to_be_there = if context.bare { *is_given } else { return_home || at_start == Some(value) };
        let what = match (has_to_be_there, is_given) {
            (true, true) => "give a value inside",
            (true, false) => "`home` leaves it out: give it a value inside",
            (false, true) => "no arm has to be there, and the nearest value inside stands in for it",
            (false, false) => {
                "no arm has to be there, and what `home` leaves out stands in the middle of its range"
            }
        };
        let name = &joint.name;
        let limits = format!("{} to {}", limit.lower, limit.upper);
        let message = format!("joint `{name}` at {value} is outside its limits {limits}; {what}");
        let pointer = stated.joint_pointer(index, name);
        if has_to_be_there {
            context.faults.push(pointer, FaultCode::OutOfRange, message);
        } else {
            context.faults.warn(pointer, FaultCode::OutOfRange, message);
        }
    }
    if is_good {
        return true;
    }
    for ((limit, value), is_given) in arm.limits.iter().zip(arm.home.iter_mut()).zip(given) {
        *value = if lacks_any && !is_given { middle(limit) } else { nearest(limit, *value) };
    }
    if let (true, Some((config, _))) = (context.bare, start) {
        config.clone_from(&arm.home);
    }
    false
}

/// The middle of a joint's range; of one without end on a side, what is nearest to 0.
fn middle(limit: &JointLimits) -> f64 {
    let middle = limit.lower + (limit.upper - limit.lower) / 2.0;
    if middle.is_finite() { middle } else { nearest(limit, 0.0) }
}

/// The value within the limits that is nearest to `value`.
fn nearest(limit: &JointLimits, value: f64) -> f64 {
    value.max(limit.lower).min(limit.upper)
}

/// The digest under which what is compiled of a workcell is kept: `digest`, that of the workcell, unless its arms have other
/// homes than those that follow from it. What is compiled depends on them.
pub fn digest_with(digest: String, homes: &[Option<Config>]) -> String {
    if homes.iter().all(Option::is_none) {
        return digest;
    }
    let mut text = digest;
    for (arm, home) in homes.iter().enumerate() {
        for value in home.iter().flatten() {
            text.push_str(&format!("\n{arm} {:x}", value.to_bits()));
        }
    }
    sha256(text.as_bytes())
}
