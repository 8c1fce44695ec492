//! Tasks: what is tested one after the other, and how many times.
//!
//! Does not know frames.

use super::exchange::FlowScript;
use super::malformed::MALFORMED;
use super::rule::ConformanceRule as Rule;
use crate::time::Duration;

/// Reserved request types that are sent.
const RESERVED: [u8; 5] = [0x00, 0x03, 0x7F, 0x81, 0xFF];
/// Time in which a receiver may hold flow control back (N_Br), well below N_Bs.
const HOLD: Duration = Duration::from_millis(250);
/// Time after which flow control comes too late: N_Bs and as long again, and more.
const LATE: Duration = Duration::from_millis(2500);
/// STmin of the test, in milliseconds.
pub(super) const TEST_ST_MIN: u8 = 20;

/// A test of segmented answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TransferTest {
    /// Flow control comes late, within N_Bs.
    Hold,
    /// A block size of 2, and later flow control.
    BlockSize,
    /// STmin.
    StMin,
    /// WAIT before CONTINUE.
    Wait,
    /// OVERFLOW.
    Overflow,
    /// Flow control after N_Bs.
    Timeout,
}

impl TransferTest {
    const ALL: [Self; 6] =
        [Self::Hold, Self::BlockSize, Self::StMin, Self::Wait, Self::Overflow, Self::Timeout];

    /// The rule that it tests.
    pub const fn rule(self) -> Rule {
        match self {
            Self::Hold => Rule::FlowControlAwaited,
            Self::BlockSize => Rule::BlockSizeKept,
            Self::StMin => Rule::StMinKept,
            Self::Wait => Rule::FlowWaitKept,
            Self::Overflow => Rule::OverflowKept,
            Self::Timeout => Rule::FlowTimeoutKept,
        }
    }

    /// Its flow control.
    pub const fn script(self) -> FlowScript {
        let plain = FlowScript::PLAIN;
        match self {
            Self::Hold => FlowScript { hold: HOLD, ..plain },
            Self::BlockSize => FlowScript { block_size: 2, block_hold: HOLD, ..plain },
            Self::StMin => FlowScript { st_min: TEST_ST_MIN, ..plain },
            Self::Wait => FlowScript { waits: 2, ..plain },
            Self::Overflow => FlowScript { overflow: true, ..plain },
            Self::Timeout => FlowScript { hold: LATE, ..plain },
        }
    }
}

/// A test of the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ProofTask {
    /// Which framing and which D flag the device answers in.
    FindFraming,
    /// A name request to it.
    Name,
    /// A name request to all.
    Broadcast,
    /// A services request.
    Services,
    /// A services request, answered in several frames.
    Transfer(TransferTest),
    /// A name request with the D flag of the other modes.
    OtherFlag { is_broadcast: bool },
    /// A name request to another address.
    OtherAddress,
    /// A name request to another device, and at once one to this one.
    WhileOthersAsked,
    /// A reserved request type.
    Reserved { kind: u8, is_broadcast: bool },
    /// A malformed request of the table.
    Malformed(usize),
    /// Requests that never end.
    Endless,
    /// A frame from its address, with that U.
    Displace { from_non_working: bool },
    /// Frames from its address while it resolves its address.
    Occupy,
    /// The other kind of mode, by command; then back.
    ChangeMode,
    /// A bus load of 80 % begins.
    BeginLoad,
    /// A name request on the loaded bus.
    LoadedName,
    /// A services request on the loaded bus.
    LoadedServices,
    /// The load ends.
    EndLoad,
    /// The user switches the device off and on.
    Reboot,
    /// A name request after it.
    NameAfterReboot,
    /// A services request after it.
    ServicesAfterReboot,
}

impl ProofTask {
    /// All tasks of a device, in their order: what may silence it is last.
    pub fn agenda() -> Vec<Self> {
        let mut tasks = vec![Self::FindFraming];
        tasks.extend([Self::Name; 4]);
        tasks.extend([Self::Broadcast; 3]);
        tasks.extend([Self::Services; 3]);
        tasks.extend([Self::OtherFlag { is_broadcast: false }; 2]);
        tasks.push(Self::OtherFlag { is_broadcast: true });
        tasks.extend([Self::OtherAddress; 2]);
        tasks.extend([Self::WhileOthersAsked; 2]);
        let reserved = [false, true].map(|is_broadcast| {
            RESERVED.into_iter().map(move |kind| Self::Reserved { kind, is_broadcast })
        });
        tasks.extend(reserved.into_iter().flatten());
        tasks.extend((0..MALFORMED.len()).map(Self::Malformed));
        tasks.extend([Self::Endless; 2]);
        tasks
    }

    /// What throws a device out of its work.
    pub fn disruptions() -> Vec<Self> {
        let displace =
            [true, true, false, false].map(|from_non_working| Self::Displace { from_non_working });
        let flags =
            [Self::OtherFlag { is_broadcast: false }, Self::OtherFlag { is_broadcast: true }];
        let mut tasks = displace.to_vec();
        tasks.extend([Self::Occupy; 2]);
        tasks.push(Self::ChangeMode);
        tasks.extend(flags);
        tasks.extend([Self::Name; 2]);
        tasks.extend(displace);
        tasks.push(Self::ChangeMode);
        tasks.extend(flags);
        tasks
    }

    /// Tests on a loaded bus.
    pub fn loads() -> Vec<Self> {
        let mut tasks = vec![Self::BeginLoad];
        tasks.extend([Self::LoadedName; 5]);
        tasks.extend([Self::LoadedServices; 2]);
        tasks.push(Self::EndLoad);
        tasks
    }

    /// Tests of a reboot.
    pub fn reboot() -> Vec<Self> {
        vec![Self::Services, Self::Reboot, Self::NameAfterReboot, Self::ServicesAfterReboot]
    }

    /// Returns true if the device is observed until the task begins.
    pub const fn needs_observation(self) -> bool {
        self.is_disruption() || matches!(self, Self::BeginLoad | Self::Reboot)
    }

    /// Returns true if the task throws the device out of its work.
    pub const fn is_disruption(self) -> bool {
        matches!(self, Self::Displace { .. } | Self::Occupy | Self::ChangeMode)
    }

    /// Returns true if the task may stop a device that stumbles over it.
    pub const fn may_stop_device(self) -> bool {
        matches!(self, Self::Malformed(_) | Self::Endless)
    }

    /// Tests of segmented answers.
    pub fn transfers() -> impl Iterator<Item = Self> {
        TransferTest::ALL.into_iter().flat_map(|test| [Self::Transfer(test); 2])
    }

    /// Returns true if the device must answer the request.
    pub const fn demands_answer(self) -> bool {
        matches!(
            self,
            Self::FindFraming
                | Self::Name
                | Self::Broadcast
                | Self::Services
                | Self::Transfer(_)
                | Self::WhileOthersAsked
                | Self::LoadedName
                | Self::LoadedServices
                | Self::NameAfterReboot
                | Self::ServicesAfterReboot
        )
    }

    /// Returns true if the answer is a list of services.
    pub const fn is_about_services(self) -> bool {
        matches!(
            self,
            Self::Services | Self::Transfer(_) | Self::LoadedServices | Self::ServicesAfterReboot
        )
    }

    /// What is done, in some words.
    pub const fn activity(self) -> &'static str {
        match self {
            Self::FindFraming => "looks for its framing",
            Self::Name | Self::Broadcast => "requests its name",
            Self::Services => "requests its services",
            Self::Transfer(_) => "tests its transfers",
            Self::OtherFlag { .. } => "sends requests to the other modes",
            Self::OtherAddress | Self::WhileOthersAsked => "sends requests to other addresses",
            Self::Reserved { .. } => "sends requests of reserved types",
            Self::Malformed(_) => "sends malformed requests",
            Self::Endless => "sends requests that never end",
            Self::Displace { .. } => "sends a frame from its address and waits",
            Self::Occupy => "occupies its address and waits",
            Self::ChangeMode => "changes its mode",
            Self::BeginLoad | Self::LoadedName | Self::LoadedServices | Self::EndLoad => {
                "loads the bus to 80 %"
            }
            Self::Reboot => "waits for the power switch",
            Self::NameAfterReboot | Self::ServicesAfterReboot => "compares it after the reboot",
        }
    }

    /// The rule that says so.
    pub const fn answer_rule(self) -> Rule {
        match self {
            Self::Broadcast => Rule::AnswersBroadcast,
            Self::Services | Self::Transfer(_) => Rule::AnswersServices,
            Self::WhileOthersAsked => Rule::AnswersWhileOthersAsked,
            Self::LoadedName | Self::LoadedServices => Rule::AnswersUnderLoad,
            _ => Rule::AnswersName,
        }
    }
}
