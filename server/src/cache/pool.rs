//! Slots of the atlas: who may write where.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// A place for one tile in the atlas.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Slot(pub u32);

/// Hands out slots up to a limit, the lowest first, so that the atlas's last pages empty when tiles go.
#[derive(Debug)]
pub struct SlotPool {
    limit: u32,
    used: u32,
    next: u32,
    free: BinaryHeap<Reverse<u32>>,
}

impl SlotPool {
    /// A pool of at most `limit` slots.
    #[must_use]
    pub fn new(limit: u32) -> Self {
        Self {
            limit,
            used: 0,
            next: 0,
            free: BinaryHeap::new(),
        }
    }

    /// The lowest free slot, or none at the limit.
    pub fn allocate(&mut self) -> Option<Slot> {
        let slot = match self.free.pop() {
            Some(Reverse(slot)) => slot,
            None if self.next < self.limit => {
                self.next += 1;
                self.next - 1
            }
            None => return None,
        };
        self.used += 1;
        Some(Slot(slot))
    }

    /// Takes a slot back.
    pub fn release(&mut self, slot: Slot) {
        self.used -= 1;
        self.free.push(Reverse(slot.0));
        // Nothing in use: start again from the bottom.
        if self.used == 0 {
            self.free.clear();
            self.next = 0;
        }
    }

    /// Slots in use.
    #[must_use]
    pub fn used(&self) -> u32 {
        self.used
    }

    /// Slots that may be in use at most.
    #[must_use]
    pub fn limit(&self) -> u32 {
        self.limit
    }

    /// One more than the highest slot that was handed out since the pool was last empty.
    #[must_use]
    pub fn high_water(&self) -> u32 {
        self.next
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashSet;

    proptest! {
        #[test]
        fn no_slot_has_two_owners_and_none_is_lost(steps in proptest::collection::vec((any::<bool>(), 0usize..64), 1..300)) {
            let mut pool = SlotPool::new(20);
            let mut held: Vec<Slot> = Vec::new();
            for (take, index) in steps {
                if take {
                    match pool.allocate() {
                        Some(slot) => {
                            prop_assert!(slot.0 < 20);
                            prop_assert!(!held.contains(&slot));
                            held.push(slot);
                        }
                        None => prop_assert_eq!(held.len(), 20),
                    }
                } else if !held.is_empty() {
                    let slot = held.swap_remove(index % held.len());
                    pool.release(slot);
                }
                prop_assert_eq!(pool.used() as usize, held.len());
                let distinct: HashSet<_> = held.iter().collect();
                prop_assert_eq!(distinct.len(), held.len());
            }
        }
    }
}
