//! A connection to the Foxglove WebSocket: its bytes, and when its queue is sent.

use std::io;

use tokio::time::{Instant, timeout};
use tungstenite::protocol::frame::coding::{Control, Data, OpCode};

use super::{Link, READ_BYTES, REQUEST_TIMEOUT, admit, read, shut_down, with_policy};
use crate::error::Error;
use crate::http::{self, Upgrade};
use crate::live::{Actions, Client, wire};
use crate::server::ConnectionContext;
use crate::server::slots::Pool;
use crate::site::Counters;
use crate::websocket::{Event, FrameReader, write_frame};

/// Most bytes of a client's message.
const REQUEST_BYTES_MAX: usize = 64 << 10;
/// Most bytes of messages that are written at once.
const WRITE_BYTES: usize = 256 << 10;

impl Link {
    /// Serves a client of the Foxglove WebSocket until it disconnects.
    pub(super) async fn serve_live(&mut self, context: &ConnectionContext) -> Result<(), Error> {
        let Some(actions) = &context.live else {
            return Ok(());
        };
        let mut frames = FrameReader::of_bytes(REQUEST_BYTES_MAX);
        let request = self.read_live_request(context, &mut frames);
        let upgrade = match timeout(REQUEST_TIMEOUT, request).await {
            Ok(Ok(Some(Ok(upgrade)))) => upgrade,
            Ok(Ok(Some(Err(response)))) => {
                self.send(response.to_string().as_bytes()).await?;
                return self.finish().await;
            }
            Ok(Ok(None)) => return Ok(()),
            Ok(Err(error)) => return Err(error),
            Err(_) => return Err(self.io_error(io::ErrorKind::TimedOut.into())),
        };
        admit(context, Pool::Messages(upgrade.credential))?;
        self.send(upgrade.response.as_bytes()).await?;
        let first = [Some(actions.server_info()), actions.advertise()];
        let client = actions.hub().enter(first.into_iter().flatten().collect());
        self.exchange_live(&mut frames, &client, actions, context)
            .await
    }

    /// Reads the handshake; bytes behind it are those of frames.
    async fn read_live_request(
        &mut self,
        context: &ConnectionContext,
        frames: &mut FrameReader,
    ) -> Result<Option<Result<Upgrade, http::Response>>, Error> {
        let mut received = Vec::new();
        while self.read(&mut received, context).await? {
            let (parsed, is_delayed) = with_policy(context, &context.live_origins, |policy| {
                http::parse_live(&received, policy)
            });
            let Some((length, result)) = parsed else {
                continue;
            };
            frames.push(received.get(length..).unwrap_or_default());
            if let Err(response) = &result
                && response.is_denial()
            {
                self.log_denial(context, response.status());
            }
            if is_delayed {
                tokio::time::sleep(crate::access::WRONG_DELAY).await;
            }
            return Ok(Some(result));
        }
        Ok(None)
    }

    async fn exchange_live(
        &mut self,
        frames: &mut FrameReader,
        client: &Client,
        actions: &Actions,
        context: &ConnectionContext,
    ) -> Result<(), Error> {
        let mut shutdown = context.shutdown.clone();
        let mut received = Vec::new();
        loop {
            while let Some(event) = frames.poll_event()? {
                match event {
                    Event::Bytes(bytes) => {
                        Counters::add(&self.counters.received, 1);
                        let answer = answer(bytes, client, actions).await;
                        self.send(&answer).await?;
                    }
                    Event::Message(_) => {}
                    Event::Ping(bytes) => {
                        let mut out = Vec::new();
                        write_frame(OpCode::Control(Control::Pong), &bytes, &mut out);
                        self.send(&out).await?;
                    }
                    Event::Close(bytes) => {
                        let mut out = Vec::new();
                        write_frame(OpCode::Control(Control::Close), &bytes, &mut out);
                        return self.send(&out).await;
                    }
                }
            }
            tokio::select! {
                biased;
                () = shut_down(&mut shutdown) => return Ok(()),
                alive = read(&mut self.stream, &mut received, READ_BYTES) => {
                    if !alive.map_err(|e| self.io_error(e))? {
                        return Ok(());
                    }
                    self.received_at = Instant::now();
                    context.slot.touch(context.site.now());
                    frames.push(&received);
                    received.clear();
                }
                () = client.filled() => {
                    let waiting = client.take(WRITE_BYTES);
                    if waiting.is_over {
                        return Err(self.io_error(io::ErrorKind::TimedOut.into()));
                    }
                    self.send(&encode(&waiting)).await?;
                    // What was sent was taken: the client is not idle.
                    context.slot.touch(context.site.now());
                }
            }
        }
    }
}

/// What waits for a client, as frames.
fn encode(waiting: &crate::live::hub::Waiting) -> Vec<u8> {
    let mut out = Vec::new();
    let text = |text: &str, out: &mut Vec<u8>| {
        write_frame(OpCode::Data(Data::Text), text.as_bytes(), out);
    };
    for line in &waiting.texts {
        text(line, &mut out);
    }
    if waiting.dropped > 0 {
        let why = format!(
            "{} messages were dropped: this client reads too slowly",
            waiting.dropped
        );
        let status = wire::status(wire::Level::Warning, &why, "takt.dropped");
        text(&status.to_string(), &mut out);
    }
    let mut payload = Vec::new();
    for message in &waiting.messages {
        payload.clear();
        wire::message(
            message.subscription,
            message.time,
            &message.data,
            &mut payload,
        );
        write_frame(OpCode::Data(Data::Binary), &payload, &mut out);
    }
    out
}

/// Handles a message of a client; returns the frames of the answer.
async fn answer(bytes: Vec<u8>, client: &Client, actions: &Actions) -> Vec<u8> {
    let error = |text: &str| vec![wire::status(wire::Level::Error, text, "takt.request")];
    let mut out = Vec::new();
    let texts = match wire::decode(&bytes) {
        wire::Request::Subscribe(pairs) => client
            .subscribe(&pairs)
            .map_or_else(Vec::new, |why| error(&why)),
        wire::Request::Unsubscribe(subscriptions) => {
            client.unsubscribe(&subscriptions);
            Vec::new()
        }
        wire::Request::GetParameters(names, id) => {
            let values = actions.parameters(&names);
            vec![wire::parameter_values(&values, id.as_deref())]
        }
        wire::Request::SetParameters(names, id) => actions.set_parameters(&names, id.as_deref()),
        wire::Request::Call(call) => {
            let (actions, of) = (actions.clone(), (call.service, call.call));
            let called = tokio::task::spawn_blocking(move || actions.call(&call)).await;
            let called = called.unwrap_or_else(|_| Err("the call panicked".to_owned()));
            match called {
                Ok(payload) => {
                    let response = wire::call_response(of.0, of.1, &payload);
                    write_frame(OpCode::Data(Data::Binary), &response, &mut out);
                    Vec::new()
                }
                Err(why) => vec![wire::call_failure(of.0, of.1, &why)],
            }
        }
        wire::Request::Ignored => Vec::new(),
        wire::Request::Unknown(why) => error(&why),
    };
    for text in texts {
        write_frame(
            OpCode::Data(Data::Text),
            text.to_string().as_bytes(),
            &mut out,
        );
    }
    out
}
