//! Slots of the atlas: who may write where.

use std::collections::BTreeSet;

/// A place for one tile in the atlas.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Slot(pub u32);

/// Hands out slots up to a limit, the lowest first, so that the atlas's last pages empty when tiles go.
#[derive(Debug)]
pub struct SlotPool {
    limit: u32,
    /// One more than the highest slot in use.
    next: u32,
    /// Those below it that are not.
    free: BTreeSet<u32>,
}

impl SlotPool {
    /// A pool of at most `limit` slots.
    #[must_use]
    pub fn new(limit: u32) -> Self {
        Self {
            limit,
            next: 0,
            free: BTreeSet::new(),
        }
    }

    /// The lowest free slot, or none at the limit.
    pub fn allocate(&mut self) -> Option<Slot> {
        let slot = match self.free.pop_first() {
            Some(slot) => slot,
            None if self.next < self.limit => {
                self.next += 1;
                self.next - 1
            }
            None => return None,
        };
        Some(Slot(slot))
    }

    /// Takes a slot back.
    pub fn release(&mut self, slot: Slot) {
        self.free.insert(slot.0);
        while self.next > 0 && self.free.remove(&(self.next - 1)) {
            self.next -= 1;
        }
    }

    /// Slots in use.
    #[must_use]
    pub fn used(&self) -> u32 {
        self.next - self.free.len() as u32
    }

    /// Slots that may be in use at most.
    #[must_use]
    pub fn limit(&self) -> u32 {
        self.limit
    }

    /// One more than the highest slot in use; 0 where none is.
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
                let highest = held.iter().map(|slot| slot.0 + 1).max();
                prop_assert_eq!(pool.high_water(), highest.unwrap_or(0));
            }
        }
    }
}
