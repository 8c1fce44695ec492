//! The devices of a bus as a plan sees them: who they are, where they are, what they have stored.

use crate::text::Name;
use crate::time::Instant;
use crate::wire::descriptor::AddressSetting;
use crate::wire::id::Address;
use crate::wire::node::Uid;
use std::fmt;

/// A set of addresses.
#[derive(Clone, Copy, PartialEq, Eq, Default)]
pub struct AddressSet(u128);

impl AddressSet {
    /// Returns true if it has the address.
    pub const fn has(self, address: Address) -> bool {
        self.0 >> address.index() & 1 == 1
    }

    /// Adds an address.
    pub const fn add(&mut self, address: Address) {
        self.0 |= 1 << address.index();
    }

    /// Returns true if it has another address than this one.
    pub const fn has_other(self, address: Address) -> bool {
        self.0 & !(1 << address.index()) != 0
    }

    /// Returns the addresses of both.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl FromIterator<Address> for AddressSet {
    fn from_iter<T: IntoIterator<Item = Address>>(addresses: T) -> Self {
        let mut set = Self::default();
        addresses.into_iter().for_each(|address| set.add(address));
        set
    }
}

impl fmt::Debug for AddressSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_set().entries(Address::all().filter(|address| self.has(*address))).finish()
    }
}

/// By what a device is recognised at another address: its UID, else its name.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct DeviceIdentity {
    /// DEV_CFG_UID; `None` if it is blank or unknown.
    pub uid: Option<Uid>,
    /// The name; `None` if it is unknown.
    pub name: Option<Name>,
}

impl DeviceIdentity {
    /// Returns true if it can be recognised at all.
    pub const fn is_known(&self) -> bool {
        self.uid.is_some() || self.name.is_some()
    }

    /// Returns true if the device with identity `other` is this one, as far as it is known.
    pub fn is_same(&self, other: &Self) -> bool {
        match (self.uid, other.uid) {
            (Some(own), Some(other)) => own == other,
            (None, None) => self.name.is_some() && self.name == other.name,
            _ => false,
        }
    }

    /// Returns true if a device with identity `other` is another one for sure.
    pub fn is_other(&self, other: &Self) -> bool {
        match (self.uid, other.uid) {
            (Some(own), Some(other)) => own != other,
            (None, Some(_)) => true,
            // The UID of the other is not known yet, or blank.
            (_, None) => match (&self.name, &other.name) {
                (Some(own), Some(other)) => own != other,
                _ => false,
            },
        }
    }

    /// Returns the name for texts; without one the UID, as hexadecimal digits.
    pub fn label(&self) -> String {
        match (&self.name, self.uid) {
            (Some(name), _) => name.to_string(),
            (None, Some(uid)) => format!("UID {}", crate::text::hex(&uid.0, "")),
            (None, None) => "the device".to_owned(),
        }
    }
}

/// What is known of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KnownDevice {
    /// Who it is.
    pub identity: DeviceIdentity,
    /// Its address, or the last one of a device that is not present.
    pub address: Address,
    /// The setting it has stored; `None` if it is unknown.
    pub setting: Option<AddressSetting>,
    /// Addresses that it may have stored, or come back to, as a plan's file tells.
    pub possible: AddressSet,
    /// It is at its address now.
    pub is_present: bool,
    /// Another device uses the same address.
    pub is_shared: bool,
    /// It is a debug device.
    pub is_debug: bool,
    /// Time of its last frame.
    pub last_heard: Instant,
}

impl KnownDevice {
    /// Returns the address it has stored, fixed or preferred.
    pub fn stored(&self) -> Option<Address> {
        self.setting.and_then(AddressSetting::address)
    }
}

/// What is known of a bus.
#[derive(Clone, Debug, Default)]
pub struct PlanBus {
    /// Its devices, also those that left.
    pub devices: Vec<KnownDevice>,
    /// descan's own address.
    pub own: Option<Address>,
    /// Addresses with a confirmed conflict.
    pub conflicts: AddressSet,
}

impl PlanBus {
    /// Returns the device at an address.
    pub fn device_at(&self, address: Address) -> Option<&KnownDevice> {
        self.devices.iter().find(|device| device.is_present && device.address == address)
    }

    /// Returns where the present device with this identity is, of several the one at `near`.
    pub fn find(&self, identity: &DeviceIdentity, near: Address) -> Option<&KnownDevice> {
        let is_it = |it: &&KnownDevice| it.is_present && identity.is_same(&it.identity);
        let mut found = self.devices.iter().filter(is_it);
        let first = found.next()?;
        if first.address == near {
            return Some(first);
        }
        found.find(|device| device.address == near).or(Some(first))
    }
}
