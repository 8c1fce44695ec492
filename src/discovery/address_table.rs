//! A value for each address, of which only those that were used take memory: few addresses of a bus are
//! used, and the past of a bus keeps many copies of its engine.

use crate::wire::id::Address;
use std::ops::{Index, IndexMut};

/// A value for each address. Those that were not used have one value together.
#[derive(Clone, Debug)]
pub(super) struct AddressTable<T> {
    /// Place of the value of each address, from 1 on; 0 is the default.
    places: [u8; Address::COUNT],
    values: Vec<T>,
    default: Box<T>,
}

impl<T: Default> AddressTable<T> {
    /// Returns the default for all addresses.
    pub fn new() -> Self {
        Self { places: [0; Address::COUNT], values: Vec::new(), default: Box::default() }
    }
}

impl<T> Index<Address> for AddressTable<T> {
    type Output = T;

    fn index(&self, address: Address) -> &T {
        match self.places[address.index()] {
            0 => &self.default,
            place => &self.values[usize::from(place) - 1],
        }
    }
}

impl<T: Clone> AddressTable<T> {
    /// Changes the values of the addresses for which `applies` returns true.
    pub fn change_where(&mut self, applies: impl Fn(Address) -> bool, change: impl Fn(&mut T)) {
        for address in Address::all() {
            let is_used = self.places[address.index()] != 0;
            match (applies(address), is_used) {
                (true, true) => change(&mut self[address]),
                // It gets its own value, that of before the change.
                (false, false) => _ = &mut self[address],
                _ => {}
            }
        }
        change(&mut self.default);
    }
}

impl<T: Clone> IndexMut<Address> for AddressTable<T> {
    fn index_mut(&mut self, address: Address) -> &mut T {
        let place = &mut self.places[address.index()];
        if *place == 0 {
            self.values.push(T::clone(&self.default));
            // At most 128 addresses.
            *place = self.values.len() as u8;
        }
        &mut self.values[usize::from(*place) - 1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_of_all_addresses_are_apart() {
        let mut table = AddressTable::<Option<u8>>::new();
        for address in Address::all().rev().filter(|address| address.number() % 3 != 0) {
            table[address] = Some(address.number());
        }
        assert_eq!(table.values.len(), 85);
        for address in Address::all() {
            let expected = Some(address.number()).filter(|number| number % 3 != 0);
            assert_eq!(table[address], expected);
        }
    }

    #[test]
    fn change_where_changes_used_and_unused_addresses() {
        let mut table = AddressTable::<u8>::new();
        for address in Address::all().filter(|address| address.number() < 10) {
            table[address] = address.number();
        }
        let is_even = |address: Address| address.number().is_multiple_of(2);
        table
            .change_where(|address| is_even(address) || address.number() > 20, |value| *value += 1);
        assert_eq!(table.values.len(), 15, "11, 13 to 19 differ from the others now");
        for address in Address::all() {
            let before = if address.number() < 10 { address.number() } else { 0 };
            let is_changed = is_even(address) || address.number() > 20;
            assert_eq!(table[address], before + u8::from(is_changed), "{address}");
        }
    }
}
