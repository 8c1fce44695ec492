//! Why a connection to a broker failed, in words, and whether trying again can help.

use super::BrokerAddress;
use crate::diagnostic::{Diagnostic, without_number};
use crate::text::on_one_line;
use rumqttc::tokio_rustls::rustls::pki_types::UnixTime;
use rumqttc::tokio_rustls::rustls::{self, CertificateError};
use rumqttc::{ConnectReturnCode, ConnectionError, DisconnectReasonCode, StateError, TlsError};
use std::error::Error;
use std::io;

/// Why a connection failed.
#[derive(Clone, Debug)]
pub struct BrokerFailure {
    /// Cause and remedy.
    pub diagnostic: Diagnostic,
    /// The same will happen again: the user is asked first.
    pub is_final: bool,
    /// Another program has the name: a wrong argument of one of them.
    pub is_name_taken: bool,
}

/// What helps where two clients have one name.
const OWN_NAME: &str = "give each gateway its own --gateway";

/// What helps where the broker refuses TLS.
const OWN_CERTIFICATE: Option<&str> =
    Some("the broker may ask for a certificate: --cert FILE --key FILE");

/// What a certificate without extensions is.
pub(super) const VERSION_1: &str = "of X.509 version 1";

/// What helps where the broker has a certificate that is not used with TLS.
const ISSUE_ANEW: &str =
    "have the CA sign one of version 3 for the broker, as descan help gateways shows";

/// What answers breaks the rules of MQTT 5.
const NO_BROKER: &str = "no MQTT 5 broker: ";

/// What helps where the broker ends the connection without a word.
const CLOSED_WITHOUT_TLS: &str = "it may want TLS (mqtts://), or have no MQTT 5";

impl BrokerFailure {
    /// Another program publishes with the same name.
    pub(super) fn replaced(address: &BrokerAddress) -> Self {
        let cause = format!("{address}: another client connected with the same name");
        Self {
            diagnostic: Diagnostic::new(cause).with_remedy(OWN_NAME),
            is_final: true,
            is_name_taken: true,
        }
    }

    /// The failure behind an error of the connection.
    /// The remedies are for a broker that was never connected.
    pub(super) fn of(
        address: &BrokerAddress,
        error: &ConnectionError,
        was_connected: bool,
    ) -> Self {
        let (cause, remedy, is_final) = words(error);
        let cause = match cause.strip_prefix(NO_BROKER).filter(|_| was_connected) {
            Some(why) => format!("the broker breaks the rules of MQTT 5: {why}"),
            None => cause,
        };
        let remedy = remedy.filter(|_| is_final || !was_connected);
        let remedy = remedy.map(|it| match it {
            CLOSED_WITHOUT_TLS if address.has_tls() => "it may have no MQTT 5",
            other => other,
        });
        let diagnostic = Diagnostic::new(format!("{address}: {cause}"));
        let diagnostic = match remedy {
            Some(remedy) => diagnostic.with_remedy(remedy),
            None => diagnostic,
        };
        Self { diagnostic, is_final, is_name_taken: false }
    }
}

/// Cause, remedy, and whether it will happen again.
fn words(error: &ConnectionError) -> (String, Option<&'static str>, bool) {
    match error {
        ConnectionError::ConnectionRefused(code)
        | ConnectionError::MqttState(StateError::ConnFail { reason: code }) => refusal(*code),
        ConnectionError::MqttState(StateError::ServerDisconnect { reason_code, .. }) => {
            disconnection(*reason_code)
        }
        ConnectionError::MqttState(StateError::IncomingPacketTooLarge { pkt_size, max }) => {
            let cause = format!("sent a packet of {pkt_size} bytes, more than the {max} agreed on");
            (cause, Some("use a broker that keeps to Maximum Packet Size of MQTT 5"), false)
        }
        ConnectionError::MqttState(StateError::ConnectionAborted) => closed(),
        ConnectionError::NotConnAck(_) => no_broker("the answer to CONNECT is another packet"),
        ConnectionError::Timeout(_) | ConnectionError::MqttState(StateError::AwaitPingResp) => {
            ("no response".to_owned(), Some("check host and port, and the firewall"), false)
        }
        other => deep(other),
    }
}

/// The cause of an error that has another one behind it.
fn deep(error: &ConnectionError) -> (String, Option<&'static str>, bool) {
    let mut cause: Option<&(dyn Error + 'static)> = Some(error);
    while let Some(error) = cause {
        if let Some(tls) = error.downcast_ref::<rustls::Error>() {
            return tls_words(tls);
        }
        if let Some(TlsError::TLS(tls)) = error.downcast_ref::<TlsError>() {
            return tls_words(tls);
        }
        if let Some(io) = error.downcast_ref::<io::Error>() {
            if let Some(tls) = io.get_ref().and_then(|it| it.downcast_ref::<rustls::Error>()) {
                return tls_words(tls);
            }
            return io_words(io);
        }
        cause = error.source();
    }
    // The client gives the cause of a failed read as text alone.
    let text = on_one_line(&error.to_string());
    if let Some((_, alert)) = text.split_once("received fatal alert") {
        return (format!("TLS: the broker refuses it{alert}"), OWN_CERTIFICATE, true);
    }
    if ["reset by peer", "roken pipe", "close_notify"].iter().any(|it| text.contains(it)) {
        return closed();
    }
    match error {
        ConnectionError::MqttState(
            StateError::Deserialization(_)
            | StateError::ProtocolViolation(_)
            | StateError::Unsolicited(_),
        ) => {
            // Without what the client puts before the cause.
            let why = text.rsplit(": ").next().unwrap_or_default();
            let mut letters = why.chars();
            let first = letters.next().map(|c| c.to_ascii_lowercase());
            no_broker(&first.into_iter().chain(letters).collect::<String>())
        }
        _ => (text, None, false),
    }
}

/// The broker ended the connection without a word.
fn closed() -> (String, Option<&'static str>, bool) {
    ("connection closed by the broker".to_owned(), Some(CLOSED_WITHOUT_TLS), false)
}

/// What answers breaks the rules of MQTT 5: a web server, a broker with MQTT 3 alone.
fn no_broker(why: &str) -> (String, Option<&'static str>, bool) {
    let remedy = "check the port; a broker with MQTT 5 is needed, such as mosquitto 1.6 and later";
    (format!("{NO_BROKER}{why}"), Some(remedy), false)
}

fn io_words(error: &io::Error) -> (String, Option<&'static str>, bool) {
    match error.kind() {
        io::ErrorKind::ConnectionRefused => (
            "connection refused".to_owned(),
            Some("check host and port, and that the broker runs"),
            false,
        ),
        io::ErrorKind::UnexpectedEof
        | io::ErrorKind::ConnectionReset
        | io::ErrorKind::ConnectionAborted
        | io::ErrorKind::BrokenPipe => closed(),
        _ => {
            let cause = on_one_line(&without_number(error));
            let remedy = cause.contains("lookup").then_some("check the name of the host");
            (cause, remedy, false)
        }
    }
}

fn tls_words(error: &rustls::Error) -> (String, Option<&'static str>, bool) {
    if let rustls::Error::InvalidCertificate(why) = error {
        let (cause, remedy) = certificate_words(why);
        return (format!("TLS: {cause}"), Some(remedy), true);
    }
    let (remedy, is_final) = match error {
        rustls::Error::AlertReceived(_) => (OWN_CERTIFICATE, true),
        rustls::Error::InvalidMessage(_) => {
            (Some("the broker may have no TLS there: mqtt://, or another port"), true)
        }
        _ => (None, false),
    };
    (format!("TLS: {}", on_one_line(&error.to_string())), remedy, is_final)
}

/// Returns true if a certificate is of X.509 version 1, for which the library has no error of its own.
pub(super) fn is_of_version_1(why: &CertificateError) -> bool {
    matches!(why, CertificateError::Other(other) if other.to_string().contains("UnsupportedCertVersion"))
}

/// Returns the local date of a time in a certificate.
fn date_of(time: UnixTime) -> String {
    let seconds = i64::try_from(time.as_secs()).unwrap_or(i64::MAX);
    let timestamp = jiff::Timestamp::from_second(seconds).unwrap_or(jiff::Timestamp::MAX);
    timestamp.to_zoned(jiff::tz::TimeZone::system()).date().to_string()
}

/// Why the certificate of the broker is refused, and what helps.
fn certificate_words(why: &CertificateError) -> (String, &'static str) {
    use CertificateError as Why;
    const RENEW: &str = "renew the broker's certificate, or check the clock of this machine";
    const NAME_CA: &str = "name the certificate that signed it: --ca FILE";
    match why {
        Why::Expired => ("the broker's certificate is not valid by its dates".to_owned(), RENEW),
        Why::ExpiredContext { not_after, .. } => {
            (format!("the broker's certificate expired on {}", date_of(*not_after)), RENEW)
        }
        Why::NotValidYet => ("the broker's certificate is not valid yet".to_owned(), RENEW),
        Why::NotValidYetContext { not_before, .. } => {
            (format!("the broker's certificate is valid from {} on", date_of(*not_before)), RENEW)
        }
        Why::NotValidForName | Why::NotValidForNameContext { .. } => {
            (on_one_line(&why.to_string()), "name the broker as its certificate does")
        }
        _ if is_of_version_1(why) => {
            (format!("the broker's certificate is {VERSION_1}"), ISSUE_ANEW)
        }
        Why::Other(other) if other.to_string().contains("CaUsedAsEndEntity") => {
            ("the broker's certificate is that of a CA".to_owned(), ISSUE_ANEW)
        }
        Why::UnknownIssuer => ("no trusted CA signed the broker's certificate".to_owned(), NAME_CA),
        Why::BadSignature => {
            ("the signature of the broker's certificate is not of its CA".to_owned(), NAME_CA)
        }
        _ => (on_one_line(&why.to_string()), NAME_CA),
    }
}

fn refusal(code: ConnectReturnCode) -> (String, Option<&'static str>, bool) {
    use ConnectReturnCode as Code;
    match code {
        Code::BadUserNamePassword | Code::NotAuthorized | Code::Banned => (
            "user or password refused".to_owned(),
            Some(
                "give them by --credentials FILE, or by DESCAN_MQTT_USER and DESCAN_MQTT_PASSWORD",
            ),
            true,
        ),
        Code::RefusedProtocolVersion | Code::UnsupportedProtocolVersion => (
            "does not speak MQTT 5".to_owned(),
            Some("use a broker with MQTT 5, such as mosquitto 1.6 and later"),
            true,
        ),
        Code::RetainNotSupported | Code::QoSNotSupported => (
            "keeps no messages, or has no QoS 1".to_owned(),
            Some("allow both for this user"),
            true,
        ),
        Code::BadClientId | Code::ClientIdentifierNotValid => {
            ("name of the client refused".to_owned(), Some("use another --gateway"), true)
        }
        other => (format!("connection refused ({other:?})"), None, false),
    }
}

fn disconnection(code: DisconnectReasonCode) -> (String, Option<&'static str>, bool) {
    use DisconnectReasonCode as Code;
    match code {
        Code::SessionTakenOver => {
            ("another client connected with the same name".to_owned(), Some(OWN_NAME), false)
        }
        Code::ServerShuttingDown => ("the broker shuts down".to_owned(), None, false),
        other => (format!("disconnected by the broker ({other:?})"), None, false),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn certificate_out_of_its_dates_is_named_with_them() {
        let at =
            |days: u64| UnixTime::since_unix_epoch(Duration::from_secs(days * 86_400 + 43_200));
        let expired = CertificateError::ExpiredContext { time: at(20_500), not_after: at(20_000) };
        assert_eq!(certificate_words(&expired).0, "the broker's certificate expired on 2024-10-04");
        let early =
            CertificateError::NotValidYetContext { time: at(20_000), not_before: at(20_500) };
        let expected = "the broker's certificate is valid from 2026-02-16 on";
        assert_eq!(certificate_words(&early).0, expected);
    }
}
