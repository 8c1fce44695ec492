//! The devices of a bus as a plan sees them: who they are, where they are, what they have stored.

use super::reason::LeftOutReason;
use crate::text::Name;
use crate::time::Instant;
use crate::wire::descriptor::AddressSetting;
use crate::wire::id::Address;
use crate::wire::node::Uid;
use crate::wire::profile::UidProfile;
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
    /// DEV_CFG_UID, which may be blank; `None` if it was not heard.
    pub uid: Option<Uid>,
    /// The name; `None` if it is unknown.
    pub name: Option<Name>,
}

impl DeviceIdentity {
    /// Returns the UID, unless it is blank or unknown.
    pub fn own_uid(&self) -> Option<Uid> {
        self.uid.and_then(Uid::not_blank)
    }

    /// Returns true if it can be recognised at all.
    pub fn is_known(&self) -> bool {
        self.own_uid().is_some() || self.name.is_some()
    }

    /// Returns true if the device with identity `other` is this one, as far as it is known.
    pub fn is_same(&self, other: &Self) -> bool {
        match (self.uid, other.uid) {
            (Some(own), Some(other_uid)) if own.is_blank() && other_uid.is_blank() => {
                self.has_name_of(other)
            }
            (Some(own), Some(other)) => own == other,
            // It may be another one with the same name, as long as its UID is not heard.
            (Some(own), None) => own.is_blank() && self.has_name_of(other),
            (None, _) => self.has_name_of(other),
        }
    }

    /// Returns true if a device with identity `other` is another one for sure.
    pub fn is_other(&self, other: &Self) -> bool {
        let has_other_name =
            self.name.is_some() && other.name.is_some() && !self.has_name_of(other);
        match (self.uid, other.uid) {
            (Some(own), Some(other)) if !(own.is_blank() && other.is_blank()) => own != other,
            _ => has_other_name,
        }
    }

    fn has_name_of(&self, other: &Self) -> bool {
        self.name.is_some() && self.name == other.name
    }

    /// Returns the UID for lists: `blank`, or a dash if it was not heard.
    pub fn uid_text(&self, alphabet: &UidProfile) -> String {
        match (self.uid, self.own_uid()) {
            (None, _) => "–".to_owned(),
            (Some(_), None) => "blank".to_owned(),
            (_, Some(uid)) => uid.text(alphabet).to_string(),
        }
    }

    /// Returns the name for texts; without one the UID, as hexadecimal digits.
    pub fn label(&self) -> String {
        match (&self.name, self.own_uid()) {
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
    /// When another device was heard last at the same address, as far as it is known to be another one.
    pub other_heard: Option<Instant>,
    /// Another board with the same UID is at this address.
    pub same_uid_at: Option<Address>,
    /// It is a debug device.
    pub is_debug: bool,
    /// Time of its first frame and of its last one.
    pub first_heard: Instant,
    /// See `first_heard`.
    pub last_heard: Instant,
}

impl KnownDevice {
    /// Returns the address it has stored, fixed or preferred.
    pub fn stored(&self) -> Option<Address> {
        self.setting.and_then(AddressSetting::address)
    }

    /// Why no plan and no pin is about the device as it is now, whatever its address is to be.
    pub const fn obstacle(&self) -> Option<LeftOutReason> {
        if !self.is_present {
            Some(LeftOutReason::NotPresent)
        } else if self.is_debug {
            Some(LeftOutReason::Debug)
        } else if self.is_shared {
            Some(LeftOutReason::Shared(self.address))
        } else {
            None
        }
    }

    /// Returns true if `row` is what remains of this device where it was before: it is not present, looks
    /// the same, and was not heard any more when this one was. Without a UID, it may be another board.
    pub fn is_trace(&self, row: &Self) -> bool {
        let is_earlier = self.identity.own_uid().is_some() || row.last_heard < self.first_heard;
        !row.is_present && is_earlier && self.identity.is_same(&row.identity)
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
    /// The bus was heard for so long that each device sent several heartbeats.
    pub is_observed: bool,
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
