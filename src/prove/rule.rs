//! The rules that a device is proved against: one table with the name, the sentence, the section of the
//! documents and what each needs.
//!
//! Does not know how a rule is proved.

/// A document that a rule comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RuleDocument {
    /// The devices enumeration service.
    Des,
    /// The CAN platform.
    Platform,
    /// ISO 15765-2. The other documents name no transport: its rules count for a device that answers
    /// with a first frame.
    Isotp,
}

impl RuleDocument {
    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Des => "DES",
            Self::Platform => "CAN platform",
            Self::Isotp => "ISO 15765-2",
        }
    }
}

/// What a rule needs to be proved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RuleNeed {
    /// Frames that the device sends by itself.
    Observation,
    /// DES requests to the device.
    Requests,
    /// Frames that take the device out of its work: `--disrupt-device`.
    Disruption,
    /// A bus load of 80 %: `--load`.
    Load,
    /// The power switch of the device: `--reboot`.
    Reboot,
}

impl RuleNeed {
    /// The word in JSON and in the guide.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Observation => "observation",
            Self::Requests => "requests",
            Self::Disruption => "disruption",
            Self::Load => "load",
            Self::Reboot => "reboot",
        }
    }

    /// The option without which it is not proved; `None` if it always is.
    pub const fn option(self) -> Option<&'static str> {
        match self {
            Self::Observation | Self::Requests => None,
            Self::Disruption => Some("--disrupt-device"),
            Self::Load => Some("--load"),
            Self::Reboot => Some("--reboot"),
        }
    }
}

macro_rules! rules {
    ($($rule:ident $id:literal $document:ident $section:literal $need:ident $sentence:literal;)*) => {
        /// A rule.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[non_exhaustive]
        pub enum ConformanceRule {
            $(
                #[doc = $sentence]
                $rule,
            )*
        }

        impl ConformanceRule {
            /// All rules, in the order of a report.
            pub const ALL: &[Self] = &[$(Self::$rule,)*];

            /// Its name in reports: `heartbeat-interval`.
            pub const fn id(self) -> &'static str {
                match self {
                    $(Self::$rule => $id,)*
                }
            }

            /// What the device must do, as a sentence without a full stop.
            pub const fn sentence(self) -> &'static str {
                match self {
                    $(Self::$rule => $sentence,)*
                }
            }

            /// The document that demands it.
            pub const fn document(self) -> RuleDocument {
                match self {
                    $(Self::$rule => RuleDocument::$document,)*
                }
            }

            /// The section of the document.
            pub const fn section(self) -> &'static str {
                match self {
                    $(Self::$rule => $section,)*
                }
            }

            /// What it needs to be proved.
            pub const fn need(self) -> RuleNeed {
                match self {
                    $(Self::$rule => RuleNeed::$need,)*
                }
            }
        }
    };
}

rules! {
    HeartbeatInterval "heartbeat-interval" Platform "3.1.7, 3.2.4.3, 3.2.4.4" Observation
        "sends one heartbeat in each interval of BUS_CFG_HR_TIME";
    MessageTypes "message-types" Platform "3.1, 4.3" Observation
        "sends only the nine message types, as data frames";
    NoRequestsUnlessWorking "no-requests-unless-working" Platform "3.2.4.3, 4.3" Observation
        "sends no requests in a mode that is not working";
    ModeFlag "mode-flag" Platform "4.1 U" Observation
        "sends U = 0 in WORK and UFUNC, U = 1 in the other modes, in all its frames";
    ErrorFlag "error-flag" Platform "4.1 ERR" Observation
        "sends ERR = 1 in all responses that report no error";
    RandomDestination "random-destination" Platform "4.1 B, DST" Observation
        "sends a random DST in broadcast frames";
    UidUnique "uid-unique" Platform "3.2, 3.2.4.3, 3.2.4.4" Observation
        "has a DEV_CFG_UID that no other device on the bus has";
    UidSetInWork "uid-set-in-work" Platform "3.2.4.4" Observation
        "works only with a DEV_CFG_UID";
    AnswersName "answers-name-request" Des "request 0x01" Requests
        "answers a name request to it";
    AnswersBroadcast "answers-broadcast" Des "request 0x01" Requests
        "answers a name request to all";
    AnswersServices "answers-services-request" Des "request 0x02" Requests
        "answers a services request";
    OneAnswer "one-answer" Des "request" Requests
        "answers each request once";
    NameFormat "name-format" Des "response 0x01" Requests
        "sends its name as the type, the name and one zero";
    ServicesFormat "services-format" Des "response 0x02" Requests
        "sends its services as the type, then for each the index 0, 1, 2, …, a name and a version, each with a zero";
    AnswerHeader "answer-header" Platform "4.1, 4.3" Requests
        "answers with R = 1, B = 0, D = U of the request, and the requester as DST";
    OwnDFlag "own-d-flag" Platform "4.1 D, 4.3" Requests
        "answers requests with D = 0 in a working mode, with D = 1 in the others, and no other ones";
    OnlyOwnRequests "only-own-requests" Platform "4.1 B, DST" Requests
        "does not answer requests to other addresses";
    AnswersWhileOthersAsked "answers-while-others-asked" Des "request" Requests
        "answers while other devices are asked";
    ReservedNotAnswered "reserved-not-answered" Des "request 0x00, 0x03–0xFF" Requests
        "does not answer reserved request types as a name or services request";
    ReservedRefused "reserved-refused" Platform "4.1 ERR, 4.3" Requests
        "answers a request to it that it cannot process with ERR = 0";
    TransferFraming "transfer-framing" Isotp "9.6.2, 9.6.4" Requests
        "sends segments of the announced length, with sequence numbers in order, and none after the last";
    FlowControlAwaited "flow-control-awaited" Isotp "9.6.5" Requests
        "sends no consecutive frame before flow control";
    BlockSizeKept "block-size" Isotp "9.6.5.3" Requests
        "sends at most the block size until the next flow control";
    StMinKept "st-min" Isotp "9.6.5.4" Requests
        "keeps STmin between consecutive frames";
    FlowWaitKept "flow-wait" Isotp "9.6.5" Requests
        "waits after WAIT, and goes on after CONTINUE";
    OverflowKept "flow-overflow" Isotp "9.6.5" Requests
        "ends a transfer after OVERFLOW";
    FlowTimeoutKept "flow-timeout" Isotp "9.8" Requests
        "ends a transfer without flow control after N_Bs, 1 s";
    SurvivesMalformed "survives-malformed-requests" Des "request" Requests
        "still answers after malformed requests";
    SurvivesEndless "survives-endless-requests" Des "request" Requests
        "still answers after requests that never end";
    GivesWayConfiguring "gives-way-configuring" Platform "3.2.4.3" Disruption
        "resolves its address after any frame from it, in CFG and BOOT";
    GivesWayWorking "gives-way-working" Platform "3.2.4.4" Disruption
        "resolves its address after a frame from it with U = 0, in WORK and UFUNC";
    KeepsAddressWorking "keeps-address-working" Platform "3.2.4.4" Disruption
        "keeps its address after a frame from it with U = 1, in WORK and UFUNC";
    ResolvesAnew "resolves-anew" Platform "3.2.4.2" Disruption
        "does not use an address that another node uses";
    ModeChanges "mode-changes" Platform "3.2.4.3, 3.2.4.4" Disruption
        "changes its mode by command, and its U and D flags with it";
    AnswersUnderLoad "answers-under-load" Des "request" Load
        "answers requests at a bus load of 80 %";
    HeartbeatUnderLoad "heartbeat-under-load" Platform "3.2.4.3, 3.2.4.4" Load
        "sends one heartbeat in each interval at a bus load of 80 %";
    StableOverReboot "stable-over-reboot" Des "response 0x01, 0x02" Reboot
        "has the same name and services after a reboot";
}
