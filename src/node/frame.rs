//! The frames of a node: extended data frames, classic or FD, without time and bus. With the feature
//! `embedded-can`, from and to the frames of CAN drivers.

use crate::frame::{CanId, Frame, fd_length};
use crate::wire::id::Header;
use core::fmt;

/// A data frame with a 29-bit identifier, the only kind of the CAN platform.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct NodeFrame {
    id: u32,
    len: u8,
    is_fd: bool,
    is_single_shot: bool,
    data: [u8; Frame::MAX_DATA],
}

impl NodeFrame {
    /// Returns a classic frame; `None` if the identifier has more than 29 bits or the data more
    /// than 8 bytes.
    pub fn classic(id: u32, data: &[u8]) -> Option<Self> {
        (data.len() <= Frame::MAX_CLASSIC_DATA).then(|| Self::checked(id, data, false))?
    }

    /// Returns a CAN FD frame; `None` if the identifier has more than 29 bits or no DLC expresses
    /// the length of the data (ISO 11898-1: 0 to 8, 12, 16, 20, 24, 32, 48, 64 bytes).
    pub fn fd(id: u32, data: &[u8]) -> Option<Self> {
        let has_dlc = data.len() <= Frame::MAX_DATA && fd_length(data.len()) == data.len();
        has_dlc.then(|| Self::checked(id, data, true))?
    }

    fn checked(id: u32, data: &[u8], is_fd: bool) -> Option<Self> {
        (id <= CanId::MAX_EXTENDED).then(|| {
            let mut frame = Self::empty(id);
            frame.data[..data.len()].copy_from_slice(data);
            frame.len = data.len() as u8;
            frame.is_fd = is_fd;
            frame
        })
    }

    const fn empty(id: u32) -> Self {
        let data = [0; Frame::MAX_DATA];
        Self { id, len: 0, is_fd: false, is_single_shot: false, data }
    }

    pub(super) const fn with_header(header: Header) -> Self {
        Self::empty(header.encode())
    }

    /// Appends data; those behind the 64th byte are dropped.
    pub(super) fn extend(&mut self, bytes: impl IntoIterator<Item = u8>) {
        let room = self.data[usize::from(self.len)..].iter_mut();
        self.len += room.zip(bytes).map(|(place, byte)| *place = byte).count() as u8;
    }

    /// Makes it an FD frame, padded to the next length that a DLC expresses.
    pub(super) fn pad_as_fd(&mut self, padding: u8) {
        let padded = fd_length(usize::from(self.len));
        self.data[usize::from(self.len)..padded].fill(padding);
        self.len = padded as u8;
        self.is_fd = true;
    }

    pub(super) fn set_single_shot(&mut self, is_single_shot: bool) {
        self.is_single_shot = is_single_shot;
    }

    /// Returns the 29-bit identifier.
    pub const fn id(&self) -> u32 {
        self.id
    }

    /// Returns the fields of the identifier.
    pub const fn header(&self) -> Header {
        Header::decode(self.id)
    }

    /// Returns the data.
    pub fn data(&self) -> &[u8] {
        &self.data[..usize::from(self.len)]
    }

    /// Returns true if it is a CAN FD frame. Whether with BRS is the firmware's choice.
    pub const fn is_fd(&self) -> bool {
        self.is_fd
    }

    /// Returns true if the controller must send it once only, without repetition after an error or
    /// a lost arbitration (bxCAN: NART). So are address claims (CAN platform §3.2.4.2).
    pub const fn is_single_shot(&self) -> bool {
        self.is_single_shot
    }

    /// Returns the frame of a driver; `None` for an 11-bit identifier and for a remote frame, which
    /// do not belong to the platform.
    #[cfg(feature = "embedded-can")]
    pub fn from_can(frame: &impl embedded_can::Frame) -> Option<Self> {
        match frame.id() {
            embedded_can::Id::Extended(id) if !frame.is_remote_frame() => {
                Self::classic(id.as_raw(), frame.data())
            }
            _ => None,
        }
    }

    /// Returns it as a frame of a driver; `None` for an FD frame, or if the driver refuses it.
    #[cfg(feature = "embedded-can")]
    pub fn to_can<F: embedded_can::Frame>(&self) -> Option<F> {
        let id = embedded_can::ExtendedId::new(self.id).filter(|_| !self.is_fd)?;
        F::new(id, self.data())
    }
}

/// As candump writes it: `02015402#0444455301`, FD as `ID##0DATA`.
impl fmt::Debug for NodeFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:08X}{}", self.id, if self.is_fd { "##0" } else { "#" })?;
        self.data().iter().try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

impl From<&NodeFrame> for Frame {
    fn from(frame: &NodeFrame) -> Self {
        if frame.is_fd {
            Frame::fd(frame.id, frame.data(), 0)
        } else {
            Frame::classic(frame.id, frame.data())
        }
    }
}

/// Fails for frames that do not belong to the platform, and returns them.
impl<'a> TryFrom<&'a Frame> for NodeFrame {
    type Error = &'a Frame;

    fn try_from(frame: &'a Frame) -> Result<Self, Self::Error> {
        let id = frame.platform_id().ok_or(frame)?;
        let node_frame = if frame.is_fd { Self::fd } else { Self::classic };
        node_frame(id, frame.data()).ok_or(frame)
    }
}

/// A classic frame; there are no remote ones, and none with 11-bit identifiers.
#[cfg(feature = "embedded-can")]
impl embedded_can::Frame for NodeFrame {
    fn new(id: impl Into<embedded_can::Id>, data: &[u8]) -> Option<Self> {
        match id.into() {
            embedded_can::Id::Extended(id) => Self::classic(id.as_raw(), data),
            embedded_can::Id::Standard(_) => None,
        }
    }

    fn new_remote(_: impl Into<embedded_can::Id>, _: usize) -> Option<Self> {
        None
    }

    fn is_extended(&self) -> bool {
        true
    }

    fn is_remote_frame(&self) -> bool {
        false
    }

    fn id(&self) -> embedded_can::Id {
        let id = embedded_can::ExtendedId::new(self.id);
        embedded_can::Id::Extended(id.unwrap_or(embedded_can::ExtendedId::ZERO))
    }

    fn dlc(&self) -> usize {
        usize::from(self.len)
    }

    fn data(&self) -> &[u8] {
        Self::data(self)
    }
}
