//! A lower bound from handoffs being meetings: how long it takes to get objects through a set of arms
//! within which each must be handed over at least once.
//!
//! Such an object enters the set, is handed over inside and leaves it, in three different steps. Of `m`
//! arms let `f` hold objects that are yet to be handed over and `g` objects that were. In a step `x`
//! objects are handed over, `n` enter and all `g` leave (waiting with them would gain nothing), where
//! `x <= f` and `x + n <= m - f - g`, since whoever takes an object must be empty. How many objects can
//! have left after so many steps follows from dynamic programming over `(f, g)`. That is more than loads
//! tell: arms cannot all be busy at both ends of the plan and take turns in between.

use super::bounds::Reach;
use super::network::{FAR, Network};
use std::collections::VecDeque;

/// Largest set of arms that is looked at.
const MOST_ARMS: usize = 24;

/// The steps that any plan needs at least to get all objects through the arms of `set`, or 0.
pub(super) fn passage(
    network: &Network,
    start: &[u16],
    reach: &Reach,
    set: &[bool],
    at_least: usize,
) -> usize {
    let arms = set.iter().filter(|&&inside| inside).count();
    if !(2..=MOST_ARMS).contains(&arms) || (start.len() * 4).div_ceil(arms) + 2 * start.len() < at_least {
        return 0;
    }
    let inside = |node: u16| set.get(network.arm_number[node as usize]).copied().unwrap_or(false);
    let nodes: Vec<u16> = (0..network.node_count() as u16).filter(|&node| inside(node)).collect();
    let (mut count, mut head, mut tail) = (0, FAR, FAR);
    for (object, &first) in start.iter().enumerate() {
        let ends_inside = network.kind(object).goals.iter().any(|&goal| inside(goal));
        if inside(first) || ends_inside || !is_handed_over(network, object, first, &inside) {
            continue;
        }
        count += 1;
        for &node in &nodes {
            let (come, go) =
                (reach.from_start[object][node as usize], network.to_goal(object, node as usize));
            if come != FAR && go != FAR {
                head = head.min(come - 1);
                tail = tail.min(go - 1);
            }
        }
    }
    match count {
        0 => 0,
        _ => usize::from(head) + steps_through(arms, count) + usize::from(tail),
    }
}

/// Whether every way of the object has a handoff between two arms inside.
fn is_handed_over(network: &Network, object: usize, start: u16, inside: &impl Fn(u16) -> bool) -> bool {
    let kind = network.kind(object);
    let mut seen = vec![false; network.node_count()];
    let mut queue = VecDeque::from([start]);
    seen[start as usize] = true;
    while let Some(node) = queue.pop_front() {
        if kind.is_goal[node as usize] {
            return false;
        }
        for &next in network.graph(object).successors(node as usize) {
            let is_meeting = inside(node) && inside(next);
            if !is_meeting && !std::mem::replace(&mut seen[next as usize], true) {
                queue.push_back(next);
            }
        }
    }
    true
}

/// The fewest steps in which `count` objects can enter `arms` arms, be handed over and leave.
fn steps_through(arms: usize, count: usize) -> usize {
    // By (f, g), the most objects that can have left.
    let width = arms + 1;
    let mut most: Vec<Option<usize>> = vec![None; width * width];
    most[0] = Some(0);
    for step in 1.. {
        let mut next: Vec<Option<usize>> = vec![None; width * width];
        for fresh in 0..=arms {
            for passed in 0..=arms - fresh {
                let Some(left) = most[fresh * width + passed] else { continue };
                let empty = arms - fresh - passed;
                for handed in 0..=fresh.min(empty) {
                    for entered in 0..=empty - handed {
                        let cell = &mut next[(fresh - handed + entered) * width + handed];
                        *cell = (*cell).max(Some(left + passed));
                    }
                }
            }
        }
        most = next;
        if most.iter().flatten().any(|&left| left >= count) {
            return step;
        }
    }
    usize::MAX
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// Breadth-first over what each arm holds (0 nothing, 1 fresh, 2 handed over), written anew.
    fn brute_force(arms: usize, count: usize) -> usize {
        let mut states: BTreeSet<(Vec<u8>, usize, usize)> = BTreeSet::from([(vec![0; arms], 0, 0)]);
        for step in 1.. {
            let mut next = BTreeSet::new();
            for (held, entered, left) in &states {
                let mut open = vec![(0, held.clone(), vec![false; arms], *entered, *left)];
                while let Some((arm, now, busy, entered, left)) = open.pop() {
                    if arm == arms {
                        let mut now = now;
                        now.sort_unstable();
                        next.insert((now, entered, left));
                        continue;
                    }
                    open.push((arm + 1, now.clone(), busy.clone(), entered, left));
                    if busy[arm] {
                        continue;
                    }
                    let mut change = |from: u8, to: u8, entered: usize, left: usize| {
                        if held[arm] == from {
                            let (mut now, mut busy) = (now.clone(), busy.clone());
                            now[arm] = to;
                            busy[arm] = true;
                            open.push((arm + 1, now, busy, entered, left));
                        }
                    };
                    if entered < count {
                        change(0, 1, entered + 1, left);
                    }
                    change(2, 0, entered, left + 1);
                    for other in 0..arms {
                        if held[arm] == 1 && held[other] == 0 && !busy[other] && now[other] == 0 {
                            let (mut now, mut busy) = (now.clone(), busy.clone());
                            (now[arm], now[other]) = (0, 2);
                            (busy[arm], busy[other]) = (true, true);
                            open.push((arm + 1, now, busy, entered, left));
                        }
                    }
                }
            }
            if next.iter().any(|(_, _, left)| *left >= count) {
                return step;
            }
            states = next;
        }
        unreachable!()
    }

    #[test]
    fn it_takes_as_long_as_brute_force_finds() {
        for arms in 2..=4 {
            for count in 1..=6 {
                assert_eq!(steps_through(arms, count), brute_force(arms, count), "{count} through {arms}");
            }
        }
    }

    #[test]
    fn loads_alone_promise_less() {
        // 50 objects through two columns of four arms: 200 acts, and 8 more that the ends cost, are 26
        // steps of 8 arms; but then half of the arms would have to change step in between.
        assert_eq!(steps_through(8, 48), 25);
        assert_eq!(steps_through(8, 50), 27);
    }
}
