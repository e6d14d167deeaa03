//! The memory as numbers, so that it can be kept from one process to the next.

use nalgebra::{Quaternion, Translation3, UnitQuaternion};

use crate::geometry::Pose;
use crate::kinematics::Config;
use crate::mode_graph::{HandoffWitness, Hold};

use super::super::contacts::bits;
use super::{HandoffQuestion, Matter, ReachMemory, RestQuestion};

/// Where the numbers come from.
type Words<'a> = dyn Iterator<Item = u64> + 'a;

impl ReachMemory {
    /// Everything that it knows, for [`Self::from_words`].
    pub fn words(&self) -> Vec<u64> {
        let known = self.known();
        let counts = [known.classes.len(), known.rests.len(), known.handoffs.len()];
        let mut words: Vec<u64> = counts.map(|count| count as u64).to_vec();
        for class in &known.classes {
            let word = |bytes: &[u8]| bytes.iter().fold(0, |word, byte| word << 8 | u64::from(*byte));
            words.extend(class.chunks(8).map(word));
        }
        for (question, answer) in &known.rests {
            let RestQuestion { class, is_place, arm, surface, pose, matter } = question;
            let matter = match matter {
                Matter::Estimate => 0,
                Matter::Any => 1,
                Matter::Grasp(grasp) => 2 + *grasp as u64,
            };
            words.extend([u64::from(*class), u64::from(*is_place), *arm as u64, *surface as u64]);
            words.extend(pose);
            words.extend([matter, u64::from(*answer)]);
        }
        for (question, answer) in &known.handoffs {
            let HandoffQuestion { class, giver, receiver, giver_grasps, receiver_grasps } = question;
            words.extend([u64::from(*class), *giver as u64, *receiver as u64]);
            for grasps in [giver_grasps, receiver_grasps] {
                words.push(grasps.len() as u64);
                words.extend(grasps.iter().map(|grasp| *grasp as u64));
            }
            words.push(u64::from(answer.is_some()));
            if let Some(HandoffWitness { giver_hold, receiver_hold, giver_q, receiver_q }) = answer {
                for hold in [giver_hold, receiver_hold] {
                    words.push(hold.grasp.map_or(0, |grasp| 1 + grasp as u64));
                    words.extend(bits(&hold.object_in_tcp));
                }
                for q in [giver_q, receiver_q] {
                    words.push(q.len() as u64);
                    words.extend(q.iter().map(|x| x.to_bits()));
                }
            }
        }
        words
    }

    /// The memory that gave [`Self::words`]; `None` where the numbers are not those of a memory.
    pub fn from_words(words: &mut Words<'_>) -> Option<Self> {
        let [classes, rests, handoffs] = [words.next()?, words.next()?, words.next()?];
        let memory = Self::new();
        {
            let mut known = memory.known();
            for _ in 0..classes {
                let mut class = [0; 32];
                for chunk in class.chunks_mut(8) {
                    chunk.copy_from_slice(&words.next()?.to_be_bytes());
                }
                known.classes.push(class);
            }
            for _ in 0..rests {
                let [class, is_place, arm, surface] = four(words)?;
                let pose = pose_bits(words)?;
                let matter = match words.next()? {
                    0 => Matter::Estimate,
                    1 => Matter::Any,
                    grasp => Matter::Grasp((grasp - 2) as usize),
                };
                let question = RestQuestion {
                    class: u32::try_from(class).ok()?,
                    is_place: is_place == 1,
                    arm: arm as usize,
                    surface: surface as usize,
                    pose,
                    matter,
                };
                known.rests.insert(question, words.next()? == 1);
            }
            for _ in 0..handoffs {
                let [class, giver, receiver] = [words.next()?, words.next()?, words.next()?];
                let question = HandoffQuestion {
                    class: u32::try_from(class).ok()?,
                    giver: giver as usize,
                    receiver: receiver as usize,
                    giver_grasps: grasps(words)?,
                    receiver_grasps: grasps(words)?,
                };
                let witness = match words.next()? {
                    0 => None,
                    _ => Some(HandoffWitness {
                        giver_hold: hold(words)?,
                        receiver_hold: hold(words)?,
                        giver_q: configuration(words)?,
                        receiver_q: configuration(words)?,
                    }),
                };
                known.handoffs.insert(question, witness);
            }
        }
        Some(memory)
    }

    /// How many answers it knows.
    pub fn len(&self) -> usize {
        let known = self.known();
        known.rests.len() + known.handoffs.len()
    }

    /// Whether it knows none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

fn four(words: &mut Words<'_>) -> Option<[u64; 4]> {
    Some([words.next()?, words.next()?, words.next()?, words.next()?])
}

fn pose_bits(words: &mut Words<'_>) -> Option<[u64; 7]> {
    let mut pose = [0; 7];
    for word in &mut pose {
        *word = words.next()?;
    }
    Some(pose)
}

fn grasps(words: &mut Words<'_>) -> Option<Vec<usize>> {
    (0..words.next()?).map(|_| words.next().map(|grasp| grasp as usize)).collect()
}

fn hold(words: &mut Words<'_>) -> Option<Hold> {
    let grasp = words.next()?.checked_sub(1).map(|grasp| grasp as usize);
    let [x, y, z, i, j, k, w] = pose_bits(words)?.map(f64::from_bits);
    // To the bit as it was: it is not normalised anew.
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
    Some(Hold { grasp, object_in_tcp: Pose::from_parts(Translation3::new(x, y, z), rotation) })
}

fn configuration(words: &mut Words<'_>) -> Option<Config> {
    (0..words.next()?).map(|_| words.next().map(f64::from_bits)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pose_from_parts;

    #[test]
    fn what_is_written_is_read_to_the_bit() {
        let memory = ReachMemory::new();
        let pose = pose_from_parts([0.1, -0.2, 0.3], [0.1, 0.2, 0.3, 0.9]);
        memory.known().classes.extend([[7; 32], [9; 32]]);
        for (number, matter) in [Matter::Estimate, Matter::Any, Matter::Grasp(3)].into_iter().enumerate() {
            let question = RestQuestion {
                class: number as u32,
                is_place: number == 1,
                arm: 4,
                surface: number,
                pose: bits(&pose),
                matter,
            };
            memory.learn_rest(question, number != 1);
        }
        let hold = Hold { grasp: Some(2), object_in_tcp: pose };
        let question = |giver| HandoffQuestion {
            class: 1,
            giver,
            receiver: 3,
            giver_grasps: vec![0, 5],
            receiver_grasps: Vec::new(),
        };
        let witness = HandoffWitness {
            giver_hold: hold,
            receiver_hold: Hold { grasp: None, ..hold },
            giver_q: [0.1, 0.2].into_iter().collect(),
            receiver_q: [-0.0, f64::MIN_POSITIVE].into_iter().collect(),
        };
        memory.learn_handoff(question(0), Some(witness));
        memory.learn_handoff(question(1), None);
        let words = memory.words();
        let again = ReachMemory::from_words(&mut words.iter().copied()).unwrap();
        assert_eq!(again.words(), words);
        assert_eq!((again.len(), memory.len()), (5, 5));
        assert_eq!(again.handoff(&question(1)), Some(None));
        assert_eq!(again.handoff(&question(0)), memory.handoff(&question(0)));
        for short in 0..words.len() {
            assert!(ReachMemory::from_words(&mut words[..short].iter().copied()).is_none(), "{short}");
        }
    }
}
