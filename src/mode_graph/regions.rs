//! From placements with known reach to regions: neighbours that the same arms reach.

use crate::workcell::ArmId;

/// A placement of one class on one surface, and who reaches it.
#[derive(Debug, Clone)]
pub(super) struct Sample {
    /// Position in the surface's frame (m).
    pub(super) at: [f64; 2],
    /// The arms that can pick and place here, ascending.
    pub(super) arms: Vec<ArmId>,
}

/// Groups samples into regions: two samples of the same non-empty set of arms that are at most
/// `reach` (m) apart belong together, and so on. Groups are sorted by their first member, members
/// ascend; samples that nobody reaches are in none.
pub(super) fn connect(samples: &[Sample], reach: f64) -> Vec<Vec<usize>> {
    let mut group: Vec<Option<usize>> = vec![None; samples.len()];
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for seed in 0..samples.len() {
        if group[seed].is_some() || samples[seed].arms.is_empty() {
            continue;
        }
        let number = groups.len();
        group[seed] = Some(number);
        let mut members = vec![seed];
        let mut next = 0;
        while let Some(&from) = members.get(next) {
            next += 1;
            for to in 0..samples.len() {
                let (a, b) = (&samples[from], &samples[to]);
                if group[to].is_none()
                    && a.arms == b.arms
                    && (a.at[0] - b.at[0]).hypot(a.at[1] - b.at[1]) <= reach
                {
                    group[to] = Some(number);
                    members.push(to);
                }
            }
        }
        members.sort_unstable();
        groups.push(members);
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sample(x: f64, y: f64, arms: &[usize]) -> Sample {
        Sample { at: [x, y], arms: arms.iter().copied().map(ArmId).collect() }
    }

    #[test]
    fn a_band_between_two_arms_is_its_own_region() {
        let reach = |x: usize| -> &[usize] {
            match x {
                0..=2 => &[0],
                3..=4 => &[0, 1],
                5..=7 => &[1],
                _ => &[],
            }
        };
        let grid =
            (0..10).flat_map(|x| (0..3).map(move |y| sample(0.1 * x as f64, 0.1 * y as f64, reach(x))));
        let groups = connect(&grid.collect::<Vec<_>>(), 0.15);
        assert_eq!(groups.iter().map(Vec::len).collect::<Vec<_>>(), [9, 6, 9]);
    }

    #[test]
    fn islands_with_the_same_arms_stay_apart() {
        let samples = [sample(0.0, 0.0, &[0]), sample(0.5, 0.0, &[0]), sample(0.1, 0.0, &[0])];
        assert_eq!(connect(&samples, 0.2), vec![vec![0, 2], vec![1]]);
    }

    proptest! {
        /// The groups are the classes of the transitive closure, by brute force.
        #[test]
        fn groups_are_connected_components(
            points in prop::collection::vec((0.0..1.0_f64, 0.0..1.0_f64, 0..3_usize), 1..25),
        ) {
            let samples: Vec<Sample> =
                points.iter().map(|&(x, y, arms)| sample(x, y, &(0..arms).collect::<Vec<_>>())).collect();
            let count = samples.len();
            let mut joined = vec![vec![false; count]; count];
            for a in 0..count {
                for b in 0..count {
                    let (p, q) = (&samples[a], &samples[b]);
                    let near = (p.at[0] - q.at[0]).hypot(p.at[1] - q.at[1]) <= 0.2;
                    joined[a][b] = near && p.arms == q.arms && !p.arms.is_empty();
                }
            }
            for via in 0..count {
                let onward = joined[via].clone();
                for row in joined.iter_mut().filter(|row| row[via]) {
                    row.iter_mut().zip(&onward).for_each(|(cell, onward)| *cell |= onward);
                }
            }
            let groups = connect(&samples, 0.2);
            let of = |index: usize| groups.iter().position(|group| group.contains(&index));
            for (a, row) in joined.iter().enumerate() {
                prop_assert_eq!(of(a).is_some(), !samples[a].arms.is_empty());
                for (b, &together) in row.iter().enumerate() {
                    prop_assert_eq!(of(a).is_some() && of(a) == of(b), together);
                }
            }
        }
    }
}
