//! A connection that reads: the messages of some topics, in order, and what happens to the connection.

use super::address::BrokerSettings;
use super::back_off;
use super::failure::BrokerFailure;
use crate::shell::waiting::block_on;
use crate::time::Duration;
use futures_util::FutureExt;
use rumqttc::{
    AckMode, AsyncClient, DisconnectProperties, DisconnectReasonCode, Event, EventLoop, Packet,
    QoS, SubscribeFilterInput, SubscribeReasonCode,
};
use std::io;
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use tokio::sync::Notify;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::time::sleep;

/// Number of messages that wait at most: a reader that is slower holds the broker back.
const MAX_WAITING: usize = 1024;

/// Number of messages that the broker sends before the first is acknowledged.
const MAX_UNREAD: u16 = 256;

/// How long a broker keeps the session of a viewer that is lost: a restart of the broker, not a viewer that
/// was killed.
const VIEWER_SESSION_SECONDS: u32 = 600;

/// What a connection brings.
#[derive(Clone, Debug)]
pub enum ReaderNotice {
    /// The broker is connected; all documents that it has follow.
    Connected,
    /// The topics are subscribed, as far as this many are allowed; the rest is refused.
    Subscribed {
        /// Number of topic filters that the broker refused.
        refused: usize,
    },
    /// A message: topic, content, and whether the broker had kept it: false for one that was published
    /// meanwhile.
    Message(Vec<u8>, Vec<u8>, bool),
    /// The connection failed, and is tried again after this time; `None` if it is not.
    Failed(BrokerFailure, Option<Duration>),
}

/// See the module's documentation. Dropped, it takes leave of the broker, for 0.2 s at most.
pub struct BrokerReader {
    notices: Receiver<ReaderNotice>,
    /// Ends the wait before the next attempt.
    wakeup: Arc<Notify>,
    thread: Option<JoinHandle<()>>,
}

/// Time to take leave of the broker.
const FAREWELL: Duration = Duration::from_millis(200);

impl Drop for BrokerReader {
    fn drop(&mut self) {
        self.notices.close();
        if let Some(thread) = self.thread.take() {
            // What it panicked with was shown already.
            let _ = thread.join();
        }
    }
}

impl BrokerReader {
    /// Connects, on a thread of its own, subscribes to these topics, and connects again when the
    /// connection is lost. The thread ends with the reader.
    ///
    /// # Errors
    /// No thread could be started.
    pub fn spawn(settings: &BrokerSettings, filters: &[&str]) -> io::Result<Self> {
        // Each viewer has a session of its own.
        let client_name = format!("descan-view-{:016x}", fastrand::u64(..));
        let mut options = settings.options(&client_name);
        // There is none to clear; and mosquitto 2.0 does not keep one that began with a clean start over
        // its own restart.
        options.set_clean_start(false);
        options.set_session_expiry_interval(Some(VIEWER_SESSION_SECONDS));
        // What was acknowledged and not read yet would be lost with the connection.
        options.set_ack_mode(AckMode::Manual);
        options.set_receive_maximum(Some(MAX_UNREAD));
        let (sender, notices) = mpsc::channel(MAX_WAITING);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let wakeup = Arc::new(Notify::new());
        let task = ReaderThread {
            notices: sender,
            wakeup: Arc::clone(&wakeup),
            settings: settings.clone(),
            filters: filters.iter().map(|it| (*it).to_owned()).collect(),
        };
        let thread = thread::Builder::new().name("broker".to_owned()).spawn(move || {
            let (client, events) =
                AsyncClient::builder(options).capacity(4 * usize::from(MAX_UNREAD)).build();
            block_on(&runtime, task.run(&client, events));
            // A name that is looked up would be waited for.
            runtime.shutdown_background();
        })?;
        Ok(Self { notices, wakeup, thread: Some(thread) })
    }

    /// Makes the next attempt without a wait; the waits begin with the shortest again.
    pub fn reconnect(&self) {
        self.wakeup.notify_one();
    }

    /// Waits for notices, and takes at most `limit` of them; none after one that says that it is not
    /// tried again. May be dropped while waiting.
    pub async fn next_many(&mut self, limit: usize) -> Vec<ReaderNotice> {
        let mut notices = Vec::new();
        self.notices.recv_many(&mut notices, limit).await;
        notices
    }

    /// Waits for the next notice; `None` after one that says that it is not tried again. May be dropped
    /// while waiting.
    pub async fn next(&mut self) -> Option<ReaderNotice> {
        self.notices.recv().await
    }
}

/// The thread of the connection.
struct ReaderThread {
    notices: Sender<ReaderNotice>,
    wakeup: Arc<Notify>,
    settings: BrokerSettings,
    filters: Vec<String>,
}

impl ReaderThread {
    async fn run(self, client: &AsyncClient, mut events: EventLoop) {
        tokio::select! {
            () = self.notices.closed() => {
                // The session ends with it: nothing is kept for a viewer that does not come back.
                let properties = DisconnectProperties {
                    session_expiry_interval: Some(0),
                    reason_string: None,
                    user_properties: Vec::new(),
                    server_reference: None,
                };
                let reason = DisconnectReasonCode::NormalDisconnection;
                let _ = client.try_disconnect_now_with_properties(reason, properties);
                let farewell = async { while events.poll().await.is_ok() {} };
                let _ = tokio::time::timeout(FAREWELL, farewell).await;
            }
            () = self.receive(client, &mut events) => {}
        }
    }

    async fn receive(&self, client: &AsyncClient, events: &mut EventLoop) {
        let mut failures = 0;
        let mut was_connected = false;
        loop {
            let notice = match events.poll().await {
                Ok(Event::Incoming(Packet::ConnAck(_))) => {
                    was_connected = true;
                    // In a kept session, too: the broker then sends all documents again. Of those that were
                    // cleared meanwhile, or lost with it, it says nothing. Not as published: the flag tells
                    // those that the broker kept.
                    let filters = self
                        .filters
                        .iter()
                        .map(|filter| SubscribeFilterInput::new(filter.as_str(), QoS::AtLeastOnce));
                    let _ = client.try_subscribe_many(filters);
                    ReaderNotice::Connected
                }
                Ok(Event::Incoming(Packet::SubAck(packet))) => {
                    let is_refused = |code: &&SubscribeReasonCode| {
                        !matches!(code, SubscribeReasonCode::Success(_))
                    };
                    failures = 0;
                    let refused = packet.return_codes.iter().filter(is_refused).count();
                    ReaderNotice::Subscribed { refused }
                }
                Ok(Event::Incoming(Packet::Publish(message))) => {
                    failures = 0;
                    let _ = client.try_ack(&message);
                    let (topic, payload) = (message.topic.to_vec(), message.payload.to_vec());
                    ReaderNotice::Message(topic, payload, message.retain)
                }
                Ok(_) => continue,
                Err(error) => {
                    let failure = BrokerFailure::of(&self.settings.address, &error, was_connected);
                    failures += 1;
                    let is_over = failure.is_final && !was_connected;
                    let wait = (!is_over).then(|| back_off(failures));
                    let notice = ReaderNotice::Failed(failure, wait);
                    // What was wanted during this attempt is done.
                    let _ = self.wakeup.notified().now_or_never();
                    if self.notices.send(notice).await.is_err() {
                        return;
                    }
                    let Some(wait) = wait else { return };
                    tokio::select! {
                        () = sleep(wait) => {}
                        () = self.wakeup.notified() => failures = 0,
                    }
                    continue;
                }
            };
            if self.notices.send(notice).await.is_err() {
                return;
            }
        }
    }
}
