//! Answers to requests that were composed, in words.
//!
//! DES responses and fields of the descriptor are decoded as in Traffic, other data are bytes. Everything is printable.

use super::capture::descriptor_content;
use crate::composer::Answer;
use crate::discovery::FieldContent;
use crate::frame::Frame;
use crate::text::{Name, counted, hex};
use crate::time::Duration;
use crate::wire::des::{self, ServicesResponse};
use crate::wire::id::Header;
use crate::wire::profile::Profile;

/// Milliseconds with one digit behind the point: `1.2 ms`.
pub fn format_millis(time: Duration) -> String {
    format!("{:.1} ms", time.as_secs_f64() * 1e3)
}

/// What an answer says, printable.
pub(super) fn answer_text(answer: &Answer, request: Option<&Frame>, profile: &Profile) -> String {
    let data = &answer.message;
    let bytes =
        if data.is_empty() { "no data".to_owned() } else { format!("data {}", hex(data, " ")) };
    if answer.is_incomplete {
        return format!("an answer that broke off after {}", counted(data.len() as u64, "byte"));
    }
    if answer.is_error {
        return if data.is_empty() {
            "error response".to_owned()
        } else {
            format!("error response, {bytes}")
        };
    }
    if answer.framing.is_some() {
        return des_text(data).unwrap_or(bytes);
    }
    let header = request.and_then(Frame::platform_id).map(Header::decode);
    match header.and_then(|header| descriptor_content(profile, header.service, data)) {
        Some((field, content @ FieldContent::Value(_))) => {
            format!("{} {} ({bytes})", field.label(), content.in_words(&profile.uid))
        }
        Some((field, content)) => format!("{} {}", field.label(), content.in_words(&profile.uid)),
        None => bytes,
    }
}

/// A DES response in words.
fn des_text(message: &[u8]) -> Option<String> {
    match *message.first()? {
        des::TYPE_NAME => {
            let (name, fault) = des::decode_name(message);
            let fault = fault.map(|fault| format!(" ({fault})")).unwrap_or_default();
            Some(format!("name {}{fault}", Name::new(name?)))
        }
        des::TYPE_SERVICES => {
            let response = ServicesResponse::decode(message);
            let services: Vec<String> = response
                .services()
                .map(|service| {
                    let strings: Vec<String> =
                        service.strings().map(|it| Name::new(it).to_string()).collect();
                    strings.join(" ")
                })
                .collect();
            let fault = response.fault().map(|fault| format!(" ({fault})")).unwrap_or_default();
            let count = counted(services.len() as u64, "service");
            let list = if services.is_empty() {
                String::new()
            } else {
                format!(": {}", services.join(", "))
            };
            Some(format!("{count}{list}{fault}"))
        }
        _ => None,
    }
}
