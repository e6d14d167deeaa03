//! The beat: in which of every two steps each arm takes objects on.
//!
//! Where all arms have much to do, each takes an object in one step and gives it away in the next. Streams
//! of objects in both directions fit into one another without idle steps if neighbouring arms take in
//! turn, all in one beat. The arms get their turns greedily: the more objects have a shortest way on
//! which one arm hands over to another, the sooner these two are set apart.

use super::bounds::Reach;
use super::network::{FAR, Network};
use std::collections::BTreeMap;

/// By arm, whether it takes in odd steps (counted from 0).
pub(super) fn turns(network: &Network, start: &[u16], reach: &Reach) -> Vec<bool> {
    let arms = network.arms.len();
    let number = |node: u16| Some(network.arm_number[node as usize]).filter(|&arm| arm < arms);
    let mut passes: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (object, &first) in start.iter().enumerate() {
        let kind = network.kind(object);
        let (come, go) = (&reach.from_start[object], &kind.to_goal);
        let length = go[first as usize];
        if length == FAR {
            continue;
        }
        let is_on_way = |node: u16| {
            let (come, go) = (come[node as usize], go[node as usize]);
            come != FAR && go != FAR && come + go == length
        };
        for nodes in &network.arms {
            for &node in nodes.iter().filter(|&&node| is_on_way(node)) {
                for &next in network.graph(object).successors(node as usize) {
                    let is_nearer = go[next as usize] < go[node as usize];
                    if let (Some(giver), Some(taker), true) = (number(node), number(next), is_nearer) {
                        *passes.entry((giver.min(taker), giver.max(taker))).or_default() += 1;
                    }
                }
            }
        }
    }
    let mut passes: Vec<((usize, usize), usize)> = passes.into_iter().collect();
    passes.sort_by_key(|&(pair, count)| (std::cmp::Reverse(count), pair));
    // By arm, the group in which turns are settled, and the turn in it.
    let mut group: Vec<usize> = (0..arms).collect();
    let mut turn = vec![false; arms];
    for ((one, other), _) in passes {
        let (kept, joined) = (group[one], group[other]);
        if kept == joined {
            continue;
        }
        let flip = turn[one] == turn[other];
        for arm in (0..arms).filter(|&arm| group[arm] == joined).collect::<Vec<_>>() {
            group[arm] = kept;
            turn[arm] ^= flip;
        }
    }
    turn
}
